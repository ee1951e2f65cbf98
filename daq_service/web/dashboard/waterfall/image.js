// Read one answer of the waterfall, and find the data of each cell.

import { getBytes } from "../api.js";
import { readHeader } from "../streams.js";

/**
 * @typedef {object} WaterfallImage
 * @property {any} header
 * @property {Float32Array} minimum of each cell, row by row; NaN where there is no sample
 * @property {Float32Array} maximum
 */

/** @param {string} position @param {Record<string, string | number | null>} query @returns {Promise<WaterfallImage>} */
export async function readImage(position, query) {
  const parameters = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) if (value !== null) parameters.set(name, String(value));
  const buffer = await getBytes(`/waterfall/${position}?${parameters}`);
  if (!buffer.byteLength) throw new Error(`No record of position ${position} is stored.`);
  const { header, start } = readHeader(buffer);
  const n = header.rows * header.columns;
  return { header, minimum: new Float32Array(buffer, start, n), maximum: new Float32Array(buffer, start + 4 * n, n) };
}

/** Return the extreme that is further from zero; NaN: no sample. @param {WaterfallImage} image @param {number} cell */
export function extreme({ minimum, maximum }, cell) {
  return -minimum[cell] > maximum[cell] ? minimum[cell] : maximum[cell];
}

/** @param {WaterfallImage} image @returns {number} maximum magnitude of all cells */
export function largestMagnitude(image) {
  let found = 0;
  for (let cell = 0; cell < image.minimum.length; cell++) {
    const value = Math.abs(extreme(image, cell));
    if (value > found) found = value;
  }
  return found;
}

/** Return the row at an hour; -1: a gap. @param {any} header @param {number} hour */
export function rowAt(header, hour) {
  let [low, high] = [0, header.rows];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (header.first_h[middle] <= hour) low = middle + 1;
    else high = middle;
  }
  return low > 0 && hour < header.until_h[low - 1] ? low - 1 : -1;
}

/**
 * Return the set at an hour, of several in a row the closest one; null: a gap.
 *
 * @param {any} header
 * @param {number} hour
 * @returns {number | null}
 */
export function setAt(header, hour) {
  const row = rowAt(header, hour);
  if (row < 0) return null;
  const [first, last] = [header.first_set[row], header.last_set[row]];
  const fraction = (hour - header.first_h[row]) / (header.until_h[row] - header.first_h[row]);
  return Math.min(last, first + Math.floor(fraction * (last - first + 1)));
}

/** Return the column at a time; -1: outside the image. @param {any} header @param {number} seconds after the anchor */
export function columnAt(header, seconds) {
  const column = Math.floor((seconds - header.first_s) / header.cell_s);
  return column >= 0 && column < header.columns ? column : -1;
}
