// Zoom and pan of an axis by wheel, touch and keys; the same for hours of a test and for µs of a record.

/** @typedef {[number, number]} Span */

const PER_NOTCH = 1.25;
const NOTCH_PX = 100;
const LINE_PX = 16;
const PAN_PART = 0.25;
/** Narrower than this part of the whole nobody sees anything. */
const NARROWEST = 1e-5;

/** @param {Span} span @param {Span} whole @returns {Span | null} inside the whole; null: all of it */
export function within([from, to], [first, last]) {
  const width = Math.max(to - from, NARROWEST * (last - first));
  if (width >= last - first) return null;
  const start = Math.min(Math.max(from, first), last - width);
  return [start, start + width];
}

/** @param {Span} span @param {Span} whole @param {number} factor below 1: closer @param {number} centre stays where it is */
export function zoomed([from, to], whole, factor, centre) {
  return within([centre - (centre - from) * factor, centre + (to - centre) * factor], whole);
}

/** By how much a wheel zooms. @param {WheelEvent} event @param {number} turned */
export function wheelFactor(event, turned = event.deltaY) {
  return PER_NOTCH ** ((turned * (event.deltaMode === 1 ? LINE_PX : 1)) / NOTCH_PX);
}

/** @param {Span} span @param {Span} whole @param {number} by */
export function panned([from, to], whole, by) {
  return within([from + by, to + by], whole);
}

/**
 * @typedef {object} Zoomable
 * @property {() => Span} span what is seen
 * @property {() => Span} whole
 * @property {(span: Span | null) => void} show null: the whole
 * @property {() => number} centre where keys zoom to
 */

/** @param {KeyboardEvent} event @param {Zoomable} axis @returns {boolean} whether the key was one of these */
export function onZoomKey(event, axis) {
  const span = axis.span();
  const by = PAN_PART * (span[1] - span[0]);
  if (event.ctrlKey || event.altKey || event.metaKey) return false;
  if (event.key === "+" || event.key === "=") axis.show(zoomed(span, axis.whole(), 1 / PER_NOTCH ** 2, axis.centre()));
  else if (event.key === "-") axis.show(zoomed(span, axis.whole(), PER_NOTCH ** 2, axis.centre()));
  else if (event.key === "0") axis.show(null);
  else if (event.shiftKey && event.key === "ArrowLeft") axis.show(panned(span, axis.whole(), -by));
  else if (event.shiftKey && event.key === "ArrowRight") axis.show(panned(span, axis.whole(), by));
  else return false;
  event.preventDefault();
  return true;
}

/**
 * Wheel and fingers; a mouse that drags is uPlot's.
 *
 * @param {HTMLElement} over the plot's area
 * @param {Zoomable} axis
 */
export function attach(over, axis) {
  const valueAt = (/** @type {number} */ clientX, /** @type {Span} */ [from, to]) => {
    const box = over.getBoundingClientRect();
    return from + ((clientX - box.left) / box.width) * (to - from);
  };
  // Whoever scrolls the page and comes across a chart goes on scrolling: the wheel zooms once the pointer has moved here.
  let pointed = false;
  const scrolled = () => void (pointed = false);
  document.addEventListener("scroll", scrolled, { passive: true });
  over.addEventListener("mousemove", () => void (pointed = true));
  over.addEventListener(
    "wheel",
    (event) => {
      if (!pointed && !event.ctrlKey) return;
      const span = axis.span();
      const next = zoomed(span, axis.whole(), wheelFactor(event), valueAt(event.clientX, span));
      if (next === null && span[0] <= axis.whole()[0] && span[1] >= axis.whole()[1]) return;
      event.preventDefault();
      axis.show(next);
    },
    { passive: false },
  );
  /** @type {Map<number, number>} where each finger is */
  const fingers = new Map();
  over.addEventListener("pointerdown", (event) => event.pointerType === "touch" && fingers.set(event.pointerId, event.clientX));
  over.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (before === undefined) return;
    const span = axis.span();
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, x]) => x);
    fingers.set(event.pointerId, event.clientX);
    if (others.length === 0) axis.show(panned(span, axis.whole(), valueAt(before, span) - valueAt(event.clientX, span)));
    else {
      const wide = Math.max(1, Math.abs(event.clientX - others[0]));
      axis.show(zoomed(span, axis.whole(), Math.abs(before - others[0]) / wide, valueAt(others[0], span)));
    }
  });
  for (const name of ["pointerup", "pointercancel"]) over.addEventListener(name, (event) => fingers.delete(/** @type {PointerEvent} */ (event).pointerId));
  return () => document.removeEventListener("scroll", scrolled);
}
