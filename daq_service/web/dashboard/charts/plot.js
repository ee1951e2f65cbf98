// Build the uPlot of one chart: axes, lines with gaps, a cursor and a span that all charts share.

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { color } from "../dom.js";
import { attach } from "./gestures.js";
import { drawForecast, drawMoments, drawPoints, drawRanges } from "./marks.js";
import { missing } from "./series.js";

/**
 * @typedef {import("./chart.js").Series} Series
 * @typedef {import("./chart.js").Host} Host
 * @typedef {import("./gestures.js").Span} Span
 */

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif';
const CURSOR_KEY = "hours";
const CLICK_PX = 5;

/** Keep the powers of ten of a logarithmic axis. @param {any} _u @param {number[]} splits */
function decades(_u, splits) {
  return splits.map((v) => (Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-6 ? v : null));
}

/**
 * Return the full span of the axis; it grows in steps, so that a new set does not move everything.
 *
 * @param {number} newest hour of the newest set
 * @param {number} endHour of the schedule
 * @returns {Span}
 */
export function fullSpan(newest, endHour) {
  const max = newest || 1;
  const step = max <= 30 ? 6 : max <= 120 ? 24 : 50;
  return [0, Math.max(step, Math.min(Math.ceil((max * 1.02) / step) * step, Math.max(endHour, max)))];
}

/** @param {boolean} log @param {number | null} min @param {number | null} max */
function yRange(log, min, max) {
  if (min === null || max === null) return log ? [0.1, 100] : [0, 1];
  if (log) return [10 ** Math.floor(Math.log10(Math.max(min, 1e-3))), 10 ** Math.ceil(Math.log10(max * 1.05))];
  const pad = Math.max(0.08 * (max - min), 0.004 * Math.abs(max), 1e-9);
  return [min - pad, max + pad];
}

/**
 * Extend the range of y to the extremes of bins, which no line reaches.
 *
 * @param {any} u
 * @param {import("./series.js").Line[]} lines
 * @param {number | null} min
 * @param {number | null} max
 * @returns {[number | null, number | null]}
 */
function extremes(u, lines, min, max) {
  const [from, to] = u.series[0].idxs ?? [0, -1];
  for (const { low, high, forecast } of lines) {
    for (const value of forecast ? [...forecast.low, ...forecast.high] : [])
      [min, max] = [Math.min(min ?? value, value), Math.max(max ?? value, value)];
    for (let k = from; low && high && k <= to; k++) {
      const [lowest, highest] = [low[k], high[k]];
      if (lowest !== null && lowest !== undefined) min = Math.min(min ?? lowest, lowest);
      if (highest !== null && highest !== undefined) max = Math.max(max ?? highest, highest);
    }
  }
  return [min, max];
}

/** Return the style of axes in the current colors. */
export function axisLook() {
  const grid = { stroke: color("--grid"), width: 1 };
  return { stroke: color("--quiet"), font: FONT, labelFont: FONT, grid, ticks: { ...grid, size: 4 }, labelGap: 2 };
}

/** @param {import("./series.js").Line} line @param {() => Series} series */
function lineOptions(line, series) {
  const stroke = color(line.color);
  const gaps = (
    /** @type {any} */ u,
    /** @type {number} */ index,
    /** @type {number} */ from,
    /** @type {number} */ to,
    /** @type {[number, number][]} */ found,
  ) => {
    const { x, lines } = series();
    const drawnLine = lines[index - 1];
    // A plot that was replaced by one with fewer lines may still draw its queue.
    if (!drawnLine?.firstSets) return found;
    const all = [...found];
    for (let k = from + 1; k <= to; k++)
      if (missing(drawnLine, k - 1, k)) all.push([u.valToPos(x[k - 1], "x", true), u.valToPos(x[k], "x", true)]);
    return all.sort((a, b) => a[0] - b[0]);
  };
  // Points carry the data and are drawn by quality (marks.js); the line only connects them, except for
  // another test, whose line is dashed.
  const leads = line.points && !line.dash;
  return {
    label: line.label,
    stroke: leads ? `${stroke}4d` : stroke,
    width: leads ? 1 : 2,
    dash: line.dash,
    points: { show: false },
    spanGaps: false,
    gaps,
  };
}

/**
 * @param {HTMLElement} box
 * @param {import("./chart.js").ChartOptions} options
 * @param {Host} host
 * @param {() => Series} series what is shown now
 * @param {{onCursor: (index: number) => void, onClick: (plot: any) => void}} handlers
 */
export function makePlot(box, options, host, series, handlers) {
  const axis = axisLook();
  const log = Boolean(options.log);
  const { full } = host;
  const span = () => host.span() ?? full();
  const timeline = host.timeline();
  const dates = timeline.axis !== "hours";
  let pressed = 0;
  const now = series();
  const plot = new uPlot(
    /** @type {any} */ ({
      width: box.clientWidth,
      height: box.clientHeight,
      padding: [8, dates ? 24 : 12, 0, 0],
      legend: { show: false },
      cursor: {
        drag: { x: true, y: false, setScale: false },
        points: { show: false },
        focus: { prox: -1 },
        sync: {
          key: CURSOR_KEY,
          scales: ["x", null],
          filters: { pub: (/** @type {string} */ type) => type === "mousemove" || type === "mouseleave" },
        },
      },
      scales: {
        x: { time: false, range: span },
        y: {
          distr: log ? 3 : 1,
          range: (/** @type {any} */ u, /** @type {number | null} */ min, /** @type {number | null} */ max) =>
            yRange(log, ...extremes(u, series().lines, min, max)),
        },
      },
      axes: [
        {
          ...axis,
          label: timeline.label,
          size: dates ? 40 : 26,
          labelSize: 20,
          ...(dates
            ? {
                splits: (/** @type {any} */ u) =>
                  timeline.splits(u.scales.x.min, u.scales.x.max, u.bbox.width / devicePixelRatio),
                values: (/** @type {any} */ _u, /** @type {number[]} */ splits) => timeline.values(splits),
              }
            : {}),
        },
        {
          ...axis,
          label: now.name,
          size: 58,
          labelSize: 18,
          ...(log
            ? {
                filter: decades,
                grid: { ...axis.grid, filter: decades },
                ticks: { ...axis.ticks, filter: decades },
                values: (/** @type {any} */ _u, /** @type {(number | null)[]} */ splits) =>
                  splits.map((v) => (v === null ? "" : v.toLocaleString("en"))),
              }
            : {}),
        },
      ],
      series: [{}, ...now.lines.map((line) => lineOptions(line, series))],
      hooks: {
        drawClear: [(/** @type {any} */ u) => drawRanges(u, series().ranges)],
        draw: [
          (/** @type {any} */ u) => {
            const { x, lines, alarms, opened } = series();
            for (const line of lines) if (line.forecast) drawForecast(u, line.color, line.forecast);
            for (const line of lines) if (line.points) drawPoints(u, x, line);
            drawMoments(u, alarms, opened);
          },
        ],
        setCursor: [(/** @type {any} */ u) => handlers.onCursor(u.cursor.idx ?? -1)],
        setSelect: [
          (/** @type {any} */ u) => {
            const { left, width } = u.select;
            if (width < CLICK_PX) return;
            host.show([u.posToVal(left, "x"), u.posToVal(left + width, "x")]);
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          },
        ],
      },
    }),
    dataOf(now),
    box,
  );
  const over = /** @type {HTMLElement} */ (plot.over);
  const detach = attach(over, {
    span,
    full,
    show: (to) => host.show(to, true),
    center: () => (span()[0] + span()[1]) / 2,
  });
  over.addEventListener("mousedown", (event) => void (pressed = event.clientX));
  over.addEventListener("click", (event) => Math.abs(event.clientX - pressed) < CLICK_PX && handlers.onClick(plot));
  return { plot, detach };
}

/** Return the drawn arrays for uPlot. @param {Series} series */
export function dataOf({ x, lines }) {
  return /** @type {any} */ ([x, ...lines.map((line) => line.y)]);
}
