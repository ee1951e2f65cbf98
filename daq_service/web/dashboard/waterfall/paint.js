// Paint the image and its overlays on a canvas: hours to the right, time downwards.

import { color } from "../dom.js";
import { palette, step, themeNow } from "./colors.js";
import { extreme } from "./image.js";

/** @typedef {import("./image.js").WaterfallImage} WaterfallImage @typedef {[number, number]} Span */
/**
 * @typedef {object} Over overlays of the image
 * @property {{color: string, label: string, dash: number[], hours: number[], seconds: (number | null)[]}[]} tracks
 * @property {number[]} bad hours of bad sets
 * @property {number[]} alarms hours
 * @property {import("../charts/marks.js").Range[]} gaps
 * @property {number | null} opened hour
 */

/** Keep the value that is further from zero. @param {Float32Array} values @param {number} at @param {number} value */
function keepExtreme(values, at, value) {
  if (!Number.isNaN(value) && !(Math.abs(values[at]) >= Math.abs(value))) values[at] = value;
}

/**
 * Paint the image pixel by pixel: of all cells that a pixel touches, the value furthest from zero.
 *
 * @param {CanvasRenderingContext2D} context
 * @param {WaterfallImage} image
 * @param {Span} hours
 * @param {Span} seconds
 * @param {number} limit
 */
export function paint(context, image, hours, seconds, limit) {
  const { width, height } = context.canvas;
  const { header } = image;
  const imageData = context.createImageData(width, height);
  const pixels = new Uint32Array(imageData.data.buffer);
  const colors = palette(themeNow());
  const perPixelS = (seconds[1] - seconds[0]) / height;
  const perPixelH = (hours[1] - hours[0]) / width;
  const firsts = new Int32Array(height + 1);
  // A pixel that starts at the edge of a cell must not take the cell before, because seconds are rounded.
  for (let y = 0; y <= height; y++)
    firsts[y] = Math.floor((seconds[0] + y * perPixelS - header.first_s) / header.cell_s + 1e-6);
  /** Return the values of a row by pixel. @param {number} row */
  const columnOf = (row) => {
    const values = new Float32Array(height).fill(NaN);
    for (let y = 0; y < height; y++) {
      const last = Math.max(firsts[y], firsts[y + 1] - 1);
      for (let cell = Math.max(0, firsts[y]); cell <= last && cell < header.columns; cell++)
        keepExtreme(values, y, extreme(image, row * header.columns + cell));
    }
    return values;
  };
  /** @type {Float32Array[]} */
  const columns = [];
  const values = new Float32Array(height);
  let first = 0;
  for (let x = 0; x < width; x++) {
    const from = hours[0] + x * perPixelH;
    values.fill(NaN);
    while (first < header.rows && header.until_h[first] <= from) delete columns[first++];
    // A row that starts within a pixel is shown in it, however short: no row is skipped.
    for (let row = first; row < header.rows && header.first_h[row] < from + perPixelH; row++) {
      columns[row] ??= columnOf(row);
      for (let y = 0; y < height; y++) keepExtreme(values, y, columns[row][y]);
    }
    for (let y = 0; y < height; y++)
      if (!Number.isNaN(values[y])) pixels[y * width + x] = colors[step(values[y], limit)];
  }
  context.putImageData(imageData, 0, 0);
}

/**
 * Paint the overlays on an empty canvas: on paper a canvas that is cleared would hide the image behind it.
 *
 * @param {CanvasRenderingContext2D} context
 * @param {Over} over
 * @param {Span} hours
 * @param {Span} seconds
 */
export function paintOver(context, over, hours, seconds) {
  const { width, height } = context.canvas;
  const ratio = devicePixelRatio;
  const x = (/** @type {number} */ hour) => ((hour - hours[0]) / (hours[1] - hours[0])) * width;
  const y = (/** @type {number} */ time) => ((time - seconds[0]) / (seconds[1] - seconds[0])) * height;
  for (const gap of over.gaps) {
    const left = x(gap.from_h);
    const wide = Math.max(3 * ratio, x(gap.to_h) - left);
    context.strokeStyle = color(`--${gap.tone}`);
    context.lineWidth = ratio;
    context.setLineDash([3 * ratio, 3 * ratio]);
    context.strokeRect(left, -ratio, wide, height + 2 * ratio);
    context.setLineDash([]);
    context.fillStyle = color(`--${gap.tone}-band`);
    context.fillRect(left, 0, wide, height);
  }
  for (const track of over.tracks) {
    const path = new Path2D();
    let drawing = false;
    track.hours.forEach((hour, k) => {
      const time = track.seconds[k];
      if (time === null) drawing = false;
      else {
        path[drawing ? "lineTo" : "moveTo"](x(hour), y(time));
        drawing = true;
      }
    });
    // A rim makes the line visible on every color of the map.
    for (const [stroke, wide] of /** @type {[string, number][]} */ ([
      ["--surface", 4],
      [track.color, 2],
    ])) {
      context.strokeStyle = color(stroke);
      context.lineWidth = wide * ratio;
      context.setLineDash(stroke === "--surface" ? [] : track.dash.map((one) => one * ratio));
      context.stroke(path);
    }
    context.setLineDash([]);
  }
  context.strokeStyle = context.fillStyle = color("--alarm");
  context.lineWidth = 2 * ratio;
  for (const hour of over.bad) {
    const [px, py, r] = [x(hour), height - 6 * ratio, 4 * ratio];
    context.beginPath();
    for (const slope of [-1, 1]) {
      context.moveTo(px - r, py - slope * r);
      context.lineTo(px + r, py + slope * r);
    }
    context.stroke();
  }
  for (const hour of over.alarms) {
    const px = x(hour);
    context.beginPath();
    context.moveTo(px, 10 * ratio);
    context.lineTo(px + 5 * ratio, ratio);
    context.lineTo(px - 5 * ratio, ratio);
    context.fill();
  }
  if (over.opened !== null) {
    context.strokeStyle = color("--accent");
    context.strokeRect(x(over.opened), -ratio, ratio, height + 2 * ratio);
  }
}
