// Handle pointer, wheel, fingers and keys on the waterfall: hours across, seconds down.

import { onZoomKey, panned, wheelFactor, within, zoomed } from "../charts/gestures.js";

/** @typedef {[number, number]} Span @typedef {{hour: number, seconds: number}} Cursor */
/**
 * @typedef {object} Axis
 * @property {() => Span} span shown now
 * @property {() => Span} full
 * @property {(span: Span | null) => void} show null: the full span
 *
 * @typedef {object} Surface area that the gestures act on
 * @property {Axis} hours
 * @property {Axis} seconds
 * @property {() => DOMRect} bounds of the image in the window
 * @property {() => any} header of the image; null: there is none
 * @property {() => Cursor | null} cursor
 * @property {(cursor: Cursor | null) => void} point
 * @property {() => void} open the set at the cursor
 */

const ZOOM_KEY = 1.5;
/** Fingers that are closer to each other along an axis do not zoom it. */
const APART_PX = 30;

/** @param {Axis} axis @param {number} fraction of the shown span */
const valueAt = ({ span }, fraction) => span()[0] + fraction * (span()[1] - span()[0]);

/** @param {Axis} axis @param {number} factor below 1: closer @param {number} center stays where it is */
const zoom = ({ span, full, show }, factor, center) => show(zoomed(span(), full(), factor, center));

/** @param {HTMLElement} box @param {Surface} surface */
export function attach(box, surface) {
  const { hours, seconds, bounds } = surface;
  /** @param {MouseEvent} event @returns {Cursor | null} null: outside the image */
  const at = (event) => {
    const { left, top, width, height } = bounds();
    const [x, y] = [(event.clientX - left) / width, (event.clientY - top) / height];
    return x >= 0 && x < 1 && y >= 0 && y < 1 ? { hour: valueAt(hours, x), seconds: valueAt(seconds, y) } : null;
  };
  // A page scroll that reaches the image continues: the wheel zooms only after the pointer has moved here.
  let pointed = false;
  document.addEventListener("scroll", () => void (pointed = false), { passive: true });
  box.addEventListener("mousemove", (event) => {
    pointed = true;
    surface.point(at(event));
  });
  box.addEventListener("mouseleave", () => surface.point(null));
  box.addEventListener("click", (event) => {
    surface.point(at(event));
    surface.open();
  });
  box.addEventListener(
    "wheel",
    (event) => {
      const cursor = at(event);
      if (!cursor || (!pointed && !event.ctrlKey)) return;
      event.preventDefault();
      // With Shift some browsers report the wheel as horizontal.
      const factor = wheelFactor(event, Math.abs(event.deltaY) > Math.abs(event.deltaX) ? event.deltaY : event.deltaX);
      if (event.shiftKey) zoom(seconds, factor, cursor.seconds);
      else zoom(hours, factor, cursor.hour);
    },
    { passive: false },
  );
  box.addEventListener("keydown", (event) => onKey(event, surface));
  touch(box, surface);
}

/**
 * Move the hours with one finger, and zoom each axis by the distance of two fingers.
 *
 * @param {HTMLElement} box
 * @param {Surface} surface
 */
function touch(box, { hours, seconds, bounds }) {
  /** Where each finger is. @type {Map<number, {x: number, y: number}>} */
  const fingers = new Map();
  const where = (/** @type {PointerEvent} */ event) => ({ x: event.clientX, y: event.clientY });
  const factor = (/** @type {number} */ was, /** @type {number} */ is) =>
    Math.min(Math.abs(is), Math.abs(was)) < APART_PX ? 1 : Math.abs(was) / Math.abs(is);
  box.addEventListener(
    "pointerdown",
    (event) => event.pointerType === "touch" && fingers.set(event.pointerId, where(event)),
  );
  box.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = where(event);
    const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
    fingers.set(event.pointerId, now);
    const { left, top, width, height } = bounds();
    if (!other) {
      const [from, to] = hours.span();
      hours.show(panned([from, to], hours.full(), ((before.x - now.x) / width) * (to - from)));
      return;
    }
    zoom(hours, factor(before.x - other.x, now.x - other.x), valueAt(hours, (other.x - left) / width));
    zoom(seconds, factor(before.y - other.y, now.y - other.y), valueAt(seconds, (other.y - top) / height));
  });
  for (const name of ["pointerup", "pointercancel"])
    box.addEventListener(name, (event) => fingers.delete(/** @type {PointerEvent} */ (event).pointerId));
}

/** @param {KeyboardEvent} event @param {Surface} surface */
function onKey(event, surface) {
  const { hours, seconds } = surface;
  const header = surface.header();
  if (!header?.rows) return;
  const shownCursor = surface.cursor();
  const cursor = shownCursor ?? { hour: header.last_h.at(-1), seconds: valueAt(seconds, 0.5) };
  if (onZoomKey(event, { ...hours, center: () => cursor.hour })) return;
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.key === "PageUp" || event.key === "PageDown")
    zoom(seconds, event.key === "PageUp" ? 1 / ZOOM_KEY : ZOOM_KEY, cursor.seconds);
  else if (event.key === "Enter") surface.open();
  else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
    const [from, to] = seconds.span();
    const [first, last] = seconds.full();
    const by = (event.key === "ArrowUp" ? -1 : 1) * Math.max(header.cell_s, (to - from) / 200);
    moveTo({ ...cursor, seconds: Math.max(first, Math.min(last, cursor.seconds + by)) }, surface);
  } else if (["ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) {
    // Without a cursor the first step goes to the newest row.
    const here = shownCursor
      ? header.first_h.findLastIndex((/** @type {number} */ first) => first <= cursor.hour)
      : header.rows;
    const row = { ArrowLeft: here - 1, ArrowRight: here + 1, Home: 0, End: header.rows - 1 }[
      /** @type {"Home"} */ (event.key)
    ];
    moveTo({ ...cursor, hour: header.first_h[Math.max(0, Math.min(header.rows - 1, row))] }, surface);
  } else return;
  event.preventDefault();
}

/** Move the cursor and show its hour. @param {Cursor} cursor @param {Surface} surface */
function moveTo(cursor, { hours, point }) {
  const [from, to] = hours.span();
  const half = (to - from) / 2;
  if (cursor.hour < from || cursor.hour > to)
    hours.show(within([cursor.hour - half, cursor.hour + half], hours.full()));
  point(cursor);
}
