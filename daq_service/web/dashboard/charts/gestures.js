// Zoom and pan an axis by wheel, touch and keys: hours of a test or µs of a waveform.

/** @typedef {[number, number]} Span */

const PER_NOTCH = 1.25;
const NOTCH_PX = 100;
const LINE_PX = 16;
const PAN_FRACTION = 0.25;
/** Minimum span, as a fraction of the full one. */
const MIN_FRACTION = 1e-5;

/** @param {Span} span @param {Span} full @returns {Span | null} inside the full span; null: all of it */
export function within([from, to], [first, last]) {
  const width = Math.max(to - from, MIN_FRACTION * (last - first));
  if (width >= last - first) return null;
  const start = Math.min(Math.max(from, first), last - width);
  return [start, start + width];
}

/**
 * @param {Span} span
 * @param {Span} full
 * @param {number} factor below 1: closer
 * @param {number} center stays where it is
 */
export function zoomed([from, to], full, factor, center) {
  return within([center - (center - from) * factor, center + (to - center) * factor], full);
}

/** Return the zoom factor of a turn of the wheel. @param {WheelEvent} event @param {number} turned */
export function wheelFactor(event, turned = event.deltaY) {
  return PER_NOTCH ** ((turned * (event.deltaMode === 1 ? LINE_PX : 1)) / NOTCH_PX);
}

/** @param {Span} span @param {Span} full @param {number} by */
export function panned([from, to], full, by) {
  return within([from + by, to + by], full);
}

/**
 * @typedef {object} Zoomable
 * @property {() => Span} span shown now
 * @property {() => Span} full
 * @property {(span: Span | null) => void} show null: the full span
 * @property {() => number} center where keys zoom to
 */

/** @param {KeyboardEvent} event @param {Zoomable} axis @returns {boolean} whether the key was one of these */
export function onZoomKey(event, axis) {
  const span = axis.span();
  const by = PAN_FRACTION * (span[1] - span[0]);
  if (event.ctrlKey || event.altKey || event.metaKey) return false;
  if (event.key === "+" || event.key === "=") axis.show(zoomed(span, axis.full(), 1 / PER_NOTCH ** 2, axis.center()));
  else if (event.key === "-") axis.show(zoomed(span, axis.full(), PER_NOTCH ** 2, axis.center()));
  else if (event.key === "0") axis.show(null);
  else if (event.shiftKey && event.key === "ArrowLeft") axis.show(panned(span, axis.full(), -by));
  else if (event.shiftKey && event.key === "ArrowRight") axis.show(panned(span, axis.full(), by));
  else return false;
  event.preventDefault();
  return true;
}

/**
 * Attach wheel and touch gestures; uPlot handles a dragging mouse.
 *
 * @param {HTMLElement} over the plot's area
 * @param {Zoomable} axis
 */
export function attach(over, axis) {
  const valueAt = (/** @type {number} */ clientX, /** @type {Span} */ [from, to]) => {
    const box = over.getBoundingClientRect();
    return from + ((clientX - box.left) / box.width) * (to - from);
  };
  // A page scroll that reaches a chart continues: the wheel zooms only after the pointer has moved here.
  let pointerMoved = false;
  const onScroll = () => void (pointerMoved = false);
  document.addEventListener("scroll", onScroll, { passive: true });
  over.addEventListener("mousemove", () => void (pointerMoved = true));
  over.addEventListener(
    "wheel",
    (event) => {
      if (!pointerMoved && !event.ctrlKey) return;
      const span = axis.span();
      const next = zoomed(span, axis.full(), wheelFactor(event), valueAt(event.clientX, span));
      if (next === null && span[0] <= axis.full()[0] && span[1] >= axis.full()[1]) return;
      event.preventDefault();
      axis.show(next);
    },
    { passive: false },
  );
  /** @type {Map<number, number>} where each finger is */
  const fingers = new Map();
  over.addEventListener(
    "pointerdown",
    (event) => event.pointerType === "touch" && fingers.set(event.pointerId, event.clientX),
  );
  over.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (before === undefined) return;
    const span = axis.span();
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, x]) => x);
    fingers.set(event.pointerId, event.clientX);
    if (others.length === 0) axis.show(panned(span, axis.full(), valueAt(before, span) - valueAt(event.clientX, span)));
    else {
      const wide = Math.max(1, Math.abs(event.clientX - others[0]));
      axis.show(zoomed(span, axis.full(), Math.abs(before - others[0]) / wide, valueAt(others[0], span)));
    }
  });
  for (const name of ["pointerup", "pointercancel"])
    over.addEventListener(name, (event) => fingers.delete(/** @type {PointerEvent} */ (event).pointerId));
  return () => document.removeEventListener("scroll", onScroll);
}
