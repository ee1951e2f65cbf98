// Describe the waterfall in text: its content, its axes and the value under the cursor.

import { fixed, significant } from "../format.js";
import { columnAt, rowAt } from "./image.js";

/** @typedef {[number, number]} Span @typedef {{hour: number, seconds: number}} Cursor */

/** Return what time counts from. @param {any} header */
export function anchorOf({ align }) {
  return align === "isw" ? "ISW" : align === "first_echo" ? "first echo" : "trigger";
}

/**
 * Return the thickness that corresponds to times; from the first echo, the difference in thickness.
 *
 * @param {any} header
 * @param {Span} seconds
 * @returns {{span: Span, label: string} | null} null: the position has none
 */
export function thicknessOf({ velocity_m_per_s: velocity, delay_s: delay, align }, seconds) {
  if (velocity === null) return null;
  const from = align === "trigger" ? delay : 0;
  return {
    span: /** @type {Span} */ (seconds.map((value) => (1e3 * velocity * (value - from)) / 2)),
    label: align === "trigger" ? "Thickness (mm)" : "Thickness after it (mm)",
  };
}

/** Return the sets of a row. @param {any} header @param {number} row */
export function setsOf({ first_set, last_set }, row) {
  return first_set[row] === last_set[row] ? `${first_set[row]}` : `${first_set[row]} to ${last_set[row]}`;
}

/** @param {any} header */
function values({ shown, baseline_sets }) {
  if (shown === "normalised") return "each row divided by its maximum magnitude";
  return shown === "difference"
    ? `difference from the mean of ${baseline_sets} sets of the baseline`
    : "sensor voltage";
}

/** Return what the image shows. @param {any} header */
export function subtitleOf(header) {
  const each = header.row_sets === 1 ? "one set per row" : `${header.row_sets} sets per row`;
  const pendingText = header.pending_sets ? ` · ${header.pending_sets} sets are loading` : "";
  const unreadableText = header.unreadable_sets.length
    ? ` · cannot be read: set ${header.unreadable_sets.join(", ")}`
    : "";
  return (
    `${values(header)}, ${each}, ${significant(1e6 * header.cell_s)} µs per cell, the sample furthest ` +
    `from zero${pendingText}${unreadableText}`
  );
}

/** Return the same for screen readers. @param {any} header */
export function labelOf(header) {
  return (
    `Waterfall of position ${header.position}: ${values(header)}, ${header.rows} rows from hour ` +
    `${fixed(header.first_h[0], 1)} to ${fixed(header.last_h.at(-1), 1)}, time from the ` +
    `${anchorOf(header)}. Arrow keys move a cursor that reads values, Page Up and Page Down zoom in ` +
    "time, Enter opens the set."
  );
}

/**
 * Return the value under the cursor.
 *
 * @param {import("./image.js").WaterfallImage} image
 * @param {Cursor} cursor
 * @param {import("../timeline.js").Timeline} timeline
 */
export function readoutOf({ header, minimum, maximum }, { hour, seconds }, timeline) {
  const row = rowAt(header, hour);
  const column = columnAt(header, seconds);
  const thickness = thicknessOf(header, [seconds, seconds]);
  const parts = [
    `hour ${fixed(row < 0 ? hour : header.first_h[row], 1)}`,
    timeline.text(hour),
    `${fixed(1e6 * seconds, 2)} µs from the ${anchorOf(header)}`,
    thickness ? `${fixed(thickness.span[0], 3)} mm` : "",
  ];
  if (row < 0) return [...parts, "no waveform"].filter(Boolean).join(" · ");
  const cell = row * header.columns + column;
  const unit = header.unit === "V" ? " V" : "";
  const found =
    column < 0 || Number.isNaN(minimum[cell])
      ? "no sample"
      : `${fixed(minimum[cell], 3)} to ${fixed(maximum[cell], 3)}${unit}`;
  return [...parts, found, `set${header.first_set[row] === header.last_set[row] ? "" : "s"} ${setsOf(header, row)}`]
    .filter(Boolean)
    .join(" · ");
}
