// Draw the axes of the waterfall: hours below, time on the left, thickness on the right for a probe.

import { color } from "../dom.js";

/** @typedef {[number, number]} Span @typedef {{left: number, top: number, width: number, height: number}} Box */

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif';
const APART_PX = { across: 80, down: 44 };

/** Return round numbers in a span. @param {Span} span @param {number} maxCount @returns {number[]} */
export function ticks([from, to], maxCount) {
  const rough = (to - from) / Math.max(1, maxCount);
  const power = 10 ** Math.floor(Math.log10(rough));
  const size = /** @type {number} */ ([1, 2, 5, 10].find((one) => one * power >= rough)) * power;
  const found = [];
  for (let k = Math.ceil(from / size - 1e-9); k * size <= to + 1e-9 * size; k++)
    found.push(Number((k * size).toPrecision(12)));
  return found;
}

/**
 * @param {CanvasRenderingContext2D} context scaled to CSS pixels
 * @param {Box} box of the image
 * @param {Span} hours
 * @param {{span: Span, label: string}} down
 * @param {{span: Span, label: string} | null} right
 * @param {import("../timeline.js").Timeline} timeline
 */
export function drawAxes(context, box, hours, down, right, timeline) {
  const { left, top, width, height } = box;
  context.font = FONT;
  context.fillStyle = color("--quiet");
  context.textAlign = "center";
  context.textBaseline = "top";
  const dates = timeline.axis !== "hours";
  const across = dates ? timeline.splits(hours[0], hours[1], width) : ticks(hours, width / APART_PX.across);
  const labels = dates ? timeline.values(across) : across.map(String);
  across.forEach((hour, k) => {
    const x = left + ((hour - hours[0]) / (hours[1] - hours[0])) * width;
    labels[k].split("\n").forEach((line, row) => context.fillText(line, x, top + height + 5 + 14 * row));
  });
  context.fillText(timeline.label, left + width / 2, top + height + (dates ? 36 : 22));
  const side = (
    /** @type {{span: Span, label: string}} */ axis,
    /** @type {number} */ x,
    /** @type {number} */ labelX,
    /** @type {CanvasTextAlign} */ align,
  ) => {
    context.textBaseline = "middle";
    context.textAlign = align;
    const [low, high] = axis.span[0] < axis.span[1] ? axis.span : [axis.span[1], axis.span[0]];
    for (const value of ticks([low, high], height / APART_PX.down))
      context.fillText(String(value), x, top + ((value - axis.span[0]) / (axis.span[1] - axis.span[0])) * height);
    context.save();
    context.translate(labelX, top + height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(axis.label, 0, 0);
    context.restore();
  };
  side(down, left - 6, 8, "right");
  if (right) side(right, left + width + 6, left + width + 44, "left");
}
