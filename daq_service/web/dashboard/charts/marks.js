// Draw the marks of a chart: points by quality, baseline, pauses, disabled sets, alarms and the opened set.

import { color } from "../dom.js";

const FONT = 'system-ui, "Liberation Sans", Arial, sans-serif';
const TAU = 2 * Math.PI;
/** Rows for annotations whose labels would overlap; further ones are only in the table. */
const NOTE_ROWS = 3;

/**
 * @typedef {{from_h: number, to_h: number, label: string, tone: string, inLegend?: boolean}} Range inLegend: its
 *   label is in the legend, once, instead of on the chart
 */
/** @typedef {(path: Path2D, x: number, y: number, r: number) => void} Shape */

/** @type {Shape} */
const cross = (path, x, y, r) => {
  path.moveTo(x - r, y - r);
  path.lineTo(x + r, y + r);
  path.moveTo(x - r, y + r);
  path.lineTo(x + r, y - r);
};

/** @param {number[]} corners x and y in turn @returns {Shape} */
const polygon = (corners) => (path, x, y, r) => {
  for (let k = 0; k < corners.length; k += 2) path[k ? "lineTo" : "moveTo"](x + r * corners[k], y + r * corners[k + 1]);
  path.closePath();
};
const diamond = polygon([0, -1.35, 1.35, 0, 0, 1.35, -1.35, 0]);

/** Shapes of the chosen position, then of those drawn over it. @type {Shape[]} */
const SHAPES = [
  (path, x, y, r) => {
    path.moveTo(x + r, y);
    path.arc(x, y, r, 0, TAU);
  },
  polygon([-0.9, -0.9, 0.9, -0.9, 0.9, 0.9, -0.9, 0.9]),
  polygon([0, -1.2, 1.1, 0.9, -1.1, 0.9]),
  polygon([0, 1.2, 1.1, -0.9, -1.1, -0.9]),
];

/** @param {any} u @param {(ctx: CanvasRenderingContext2D) => void} draw inside the plot's area */
export function clipped(u, draw) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.textAlign = "left"; // the axes change it
  draw(ctx);
  ctx.restore();
}

/**
 * Draw the points of a line: filled if good, hollow if suspect, a cross if bad, a diamond if above the limit.
 *
 * @param {any} u @param {number[]} x @param {import("./series.js").Line} line
 */
export function drawPoints(u, x, line) {
  const [from, to] = u.series[0].idxs ?? [0, x.length - 1];
  const r = (to - from > 250 ? 1.9 : 2.5) * devicePixelRatio;
  const shape = SHAPES[(line.shape ?? 0) % SHAPES.length];
  const paths = {
    good: new Path2D(),
    suspect: new Path2D(),
    bad: new Path2D(),
    outlier: new Path2D(),
    spread: new Path2D(),
  };
  for (let k = from; k <= to; k++) {
    const value = line.y[k];
    const quality = line.quality?.[k];
    const px = u.valToPos(x[k], "x", true);
    if (value === null) {
      // A cross on the axis shows that nothing was measured.
      if (quality === "bad") cross(paths.bad, px, u.bbox.top + u.bbox.height - 2 * r, 1.4 * r);
      continue;
    }
    const py = u.valToPos(value, "y", true);
    const [low, high] = [line.low?.[k] ?? value, line.high?.[k] ?? value];
    if (high > low) {
      paths.spread.moveTo(px, u.valToPos(low, "y", true));
      paths.spread.lineTo(px, u.valToPos(high, "y", true));
    }
    // The outlier of a bin is its maximum, not its mean.
    if (line.outlier?.[k]) diamond(paths.outlier, px, u.valToPos(high, "y", true), 1.25 * r);
    else if (quality === "bad") cross(paths.bad, px, py, 1.4 * r);
    else shape(quality === "suspect" ? paths.suspect : paths.good, px, py, r);
  }
  clipped(u, (ctx) => {
    ctx.lineWidth = 1.4 * devicePixelRatio;
    ctx.fillStyle = ctx.strokeStyle = color(line.color);
    ctx.globalAlpha = 0.4;
    ctx.stroke(paths.spread);
    ctx.globalAlpha = 1;
    ctx.fill(paths.good);
    ctx.stroke(paths.suspect);
    ctx.fill(paths.outlier);
    ctx.strokeStyle = color("--alarm");
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.stroke(paths.bad);
  });
}

/**
 * Draw the forecast of a line: band and dashed median, and the minimum up to there.
 *
 * @param {any} u @param {string} stroke @param {import("./series.js").Forecast} forecast
 */
export function drawForecast(u, stroke, { hours, low, median, high, minimum }) {
  const line = (/** @type {number[]} */ values, /** @type {number[]} */ at = hours) =>
    values.map((value, k) => [u.valToPos(at[k], "x", true), u.valToPos(value, "y", true)]);
  const trace = (/** @type {CanvasRenderingContext2D} */ ctx, /** @type {number[][]} */ corners) => {
    ctx.beginPath();
    for (const [px, py] of corners) ctx.lineTo(px, py);
  };
  clipped(u, (ctx) => {
    ctx.fillStyle = ctx.strokeStyle = color(stroke);
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.globalAlpha = 0.15;
    trace(ctx, [...line(low), ...line(high).reverse()]);
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
    trace(ctx, line(median));
    ctx.stroke();
    if (minimum === null) return;
    ctx.strokeStyle = color("--limit");
    ctx.setLineDash([]);
    trace(ctx, line([minimum, minimum]));
    ctx.stroke();
  });
}

/**
 * Draw hours with a label at the top (baseline, pause, disabled) or at the bottom (annotation).
 *
 * @param {any} u
 * @param {Range[]} ranges
 */
export function drawRanges(u, ranges) {
  const { bbox } = u;
  const ratio = devicePixelRatio;
  clipped(u, (ctx) => {
    ctx.font = `${11 * ratio}px ${FONT}`;
    ctx.textBaseline = "top";
    /** End of the last label in each row of annotations. @type {number[]} */
    const rows = [];
    for (const range of ranges) {
      const left = u.valToPos(range.from_h, "x", true);
      const right = Math.max(u.valToPos(range.to_h, "x", true), left + 2 * ratio);
      if (right < bbox.left || left > bbox.left + bbox.width) continue;
      ctx.fillStyle = color(`--${range.tone}-band`);
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
      if (range.to_h === range.from_h) {
        ctx.fillStyle = color(`--${range.tone}`);
        ctx.fillRect(left, bbox.top, right - left, bbox.height);
      } else if (range.tone !== "good") {
        // Edges, so that color is not the only sign.
        ctx.strokeStyle = color(`--${range.tone}`);
        ctx.lineWidth = ratio;
        ctx.setLineDash([3 * ratio, 3 * ratio]);
        ctx.strokeRect(left, bbox.top - ratio, right - left, bbox.height + 2 * ratio);
        ctx.setLineDash([]);
      }
      if (range.inLegend) continue;
      const note = range.tone === "note";
      const start = Math.max(left, bbox.left) + 4 * ratio;
      const ends = note ? bbox.left + bbox.width : Math.min(right, bbox.left + bbox.width);
      const { width } = ctx.measureText(range.label);
      if (ends - start < width) continue;
      let row = 0;
      while (note && start < (rows[row] ?? 0)) row += 1;
      if (row === NOTE_ROWS) continue;
      if (note) rows[row] = start + width + 4 * ratio;
      ctx.fillStyle = color(`--${range.tone}`);
      ctx.fillText(range.label, start, note ? bbox.top + bbox.height - (15 + 13 * row) * ratio : bbox.top + 4 * ratio);
    }
  });
}

/**
 * Draw alarms as triangles on top, and the opened set as a line.
 *
 * @param {any} u
 * @param {number[]} alarms hours
 * @param {number | null} opened hour
 */
export function drawMoments(u, alarms, opened) {
  const { bbox } = u;
  const ratio = devicePixelRatio;
  clipped(u, (ctx) => {
    ctx.fillStyle = color("--alarm");
    const path = new Path2D();
    for (const hour of alarms)
      polygon([0, 1, 1, -0.8, -1, -0.8])(path, u.valToPos(hour, "x", true), bbox.top + 5 * ratio, 5 * ratio);
    ctx.fill(path);
    if (opened === null) return;
    const px = u.valToPos(opened, "x", true);
    ctx.strokeStyle = color("--accent");
    ctx.lineWidth = 1.5 * ratio;
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.moveTo(px, bbox.top);
    ctx.lineTo(px, bbox.top + bbox.height);
    ctx.stroke();
  });
}
