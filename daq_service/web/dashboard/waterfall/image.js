// One answer of the waterfall, and what each place of it holds.

import { octets } from "../api.js";
import { head } from "../streams.js";

/**
 * @typedef {object} Picture
 * @property {any} header
 * @property {Float32Array} least of each cell, row by row; NaN where there is no sample
 * @property {Float32Array} greatest
 */

/** @param {string} position @param {Record<string, string | number | null>} query @returns {Promise<Picture>} */
export async function readPicture(position, query) {
  const parameters = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) if (value !== null) parameters.set(name, String(value));
  const buffer = await octets(`/waterfall/${position}?${parameters}`);
  if (!buffer.byteLength) throw new Error(`No record of position ${position} is stored.`);
  const { header, start } = head(buffer);
  const n = header.rows * header.columns;
  return { header, least: new Float32Array(buffer, start, n), greatest: new Float32Array(buffer, start + 4 * n, n) };
}

/** The extreme that lies further from zero; NaN: no sample. @param {Picture} picture @param {number} cell */
export function extreme({ least, greatest }, cell) {
  return -least[cell] > greatest[cell] ? least[cell] : greatest[cell];
}

/** @param {Picture} picture @returns {number} greatest magnitude of all cells */
export function greatestOf(picture) {
  let found = 0;
  for (let cell = 0; cell < picture.least.length; cell++) {
    const value = Math.abs(extreme(picture, cell));
    if (value > found) found = value;
  }
  return found;
}

/** Row at an hour; -1: a gap. @param {any} header @param {number} hour */
export function rowAt(header, hour) {
  let [low, high] = [0, header.rows];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (header.first_h[middle] <= hour) low = middle + 1;
    else high = middle;
  }
  return low > 0 && hour < header.until_h[low - 1] ? low - 1 : -1;
}

/** Set at an hour, of several in a row the one that is due next to it; null: a gap. @param {any} header @param {number} hour @returns {number | null} */
export function setAt(header, hour) {
  const row = rowAt(header, hour);
  if (row < 0) return null;
  const [first, last] = [header.first_set[row], header.last_set[row]];
  const part = (hour - header.first_h[row]) / (header.until_h[row] - header.first_h[row]);
  return Math.min(last, first + Math.floor(part * (last - first + 1)));
}

/** Column at a time; -1: beside the picture. @param {any} header @param {number} seconds after the anchor */
export function columnAt(header, seconds) {
  const column = Math.floor((seconds - header.first_s) / header.cell_s);
  return column >= 0 && column < header.columns ? column : -1;
}
