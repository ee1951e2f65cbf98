// A trend over the hours of the experiment: uPlot for the drawing, a table of the same numbers for
// those who do not see it, arrow keys for those without a pointer.

import uPlot from "./vendor/uplot/uPlot.esm.js";
import { color, el, setText } from "./dom.js";
import { NONE, fixed } from "./format.js";

/**
 * @typedef {object} Curve
 * @property {string} label
 * @property {string} short for the read-out
 * @property {string} key name in the read-only state and in the table
 * @property {string} color custom property
 * @property {"points" | "line" | "diamonds"} kind
 * @property {number[]} [dash]
 * @property {boolean} [tabled] false: not a column of the table
 *
 * @typedef {object} ChartOptions
 * @property {string} title
 * @property {string} name what the y axis shows, with its unit
 * @property {number} digits of the read-out
 * @property {string} unit
 * @property {Curve[]} curves the first is the measured one
 * @property {boolean} [log]
 * @property {string} empty what to say without data
 *
 * @typedef {object} Series
 * @property {number[]} x hours
 * @property {(number | null)[][]} y one array a curve, in the units drawn
 * @property {boolean[]} [marked] points drawn as outliers
 * @property {string[]} [quality]
 * @property {number | null} [bandUntil] hour at which the baseline ends
 * @property {string} subtitle
 * @property {number} endHour
 */

const LONGEST_TABLE = 500;
const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif';

/** Keeps the powers of ten of a logarithmic axis. @param {any} _u @param {number[]} splits */
function decades(_u, splits) {
  return splits.map((v) => (Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-6 ? v : null));
}

/** @param {Curve} curve */
function swatch(curve) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 22 10");
  svg.setAttribute("width", "22");
  svg.setAttribute("height", "10");
  svg.setAttribute("aria-hidden", "true");
  const line = document.createElementNS("http://www.w3.org/2000/svg", curve.kind === "points" ? "circle" : "path");
  if (curve.kind === "points") {
    for (const [key, value] of [["cx", "11"], ["cy", "5"], ["r", "3"], ["fill", `var(${curve.color})`]]) {
      line.setAttribute(key, value);
    }
  } else if (curve.kind === "diamonds") {
    line.setAttribute("d", "M11 1l4 4l-4 4l-4-4z");
    line.setAttribute("fill", `var(${curve.color})`);
  } else {
    line.setAttribute("d", "M1 5h20");
    line.setAttribute("stroke", `var(${curve.color})`);
    line.setAttribute("stroke-width", "2");
    if (curve.dash) line.setAttribute("stroke-dasharray", curve.dash.join(" "));
  }
  svg.append(line);
  return svg;
}

export class SolimonChart extends HTMLElement {
  constructor() {
    super();
    /** @type {ChartOptions} */
    this.options = { title: "", name: "", digits: 0, unit: "", curves: [], empty: "" };
    /** @type {Series} */
    this.series = { x: [], y: [], subtitle: "", endHour: 1 };
    /** @type {any} */
    this.plot = null;
    /** Index under the pointer or the keyboard's cursor, or -1. @type {number} */
    this.cursor = -1;
    this.heading = el("h2");
    this.subtitle = el("p");
    this.toggle = el("button", { class: "button ghost small", type: "button", "aria-pressed": "false", text: "Table" });
    this.readout = el("p", { class: "readout", "aria-live": "polite" });
    this.canvasBox = el("div", { class: "plot", tabindex: "0", role: "img" });
    this.emptyText = el("p", { class: "empty" });
    this.canvasBox.append(this.emptyText);
    this.tableBox = el("div", { class: "table-wrap", tabindex: "0", role: "region", hidden: true });
    this.toggle.addEventListener("click", () => this.showTable(this.tableBox.hidden));
    this.canvasBox.addEventListener("keydown", (event) => this.onKey(event));
    new ResizeObserver(() => this.resize()).observe(this.canvasBox);
  }

  /** @param {ChartOptions} options */
  configure(options) {
    this.options = options;
    this.series = { x: [], y: options.curves.map(() => []), subtitle: "", endHour: 1 };
    this.heading.id = `${this.id}-title`;
    setText(this.heading, options.title);
    setText(this.emptyText, "Reading");
    this.toggle.setAttribute("aria-label", `Table of: ${options.title}`);
    this.tableBox.setAttribute("aria-label", `${options.title}, table`);
    const legend = el("ul", { class: "legend" });
    for (const curve of options.curves) legend.append(el("li", {}, swatch(curve), curve.label));
    if (options.log) legend.append(el("li", {}, swatch({ ...options.curves[0], color: "--alarm", kind: "diamonds" }), "outlier"));
    this.setAttribute("role", "group");
    this.setAttribute("aria-labelledby", `${this.id}-title`);
    this.append(
      el("div", { class: "card-head" }, el("div", {}, this.heading, this.subtitle), el("div", { class: "card-actions" }, this.toggle)),
      this.readout,
      this.canvasBox,
      this.tableBox,
      legend,
    );
  }

  /** @param {boolean} shown */
  showTable(shown) {
    this.tableBox.hidden = !shown;
    this.canvasBox.hidden = shown;
    this.toggle.setAttribute("aria-pressed", String(shown));
    if (shown) this.fillTable();
  }

  /** @param {Series} series */
  update(series) {
    this.series = series;
    this.dataset.points = String(series.y[0].filter((value) => value !== null).length);
    setText(this.subtitle, series.subtitle);
    setText(this.emptyText, this.options.empty);
    this.emptyText.hidden = series.x.length > 0;
    const last = series.x.length - 1;
    this.canvasBox.setAttribute("aria-label", `${this.options.title}. ${series.subtitle}. ${series.x.length} sets; arrow keys read single values. ${last >= 0 ? this.describe(last) : this.options.empty}`);
    if (this.cursor < 0 || this.cursor > last) this.showReadout(last);
    if (series.x.length) {
      if (this.plot) this.plot.setData(this.data());
      else this.draw();
    } else this.destroy();
    if (!this.tableBox.hidden) this.fillTable();
  }

  /** The drawn arrays, for uPlot. */
  data() {
    return /** @type {any} */ ([this.series.x, ...this.series.y]);
  }

  /** @param {number} index */
  describe(index) {
    const { x, y, quality } = this.series;
    const parts = [`hour ${fixed(x[index], 1)}`];
    this.options.curves.forEach((curve, i) => {
      const value = y[i]?.[index];
      if (value !== null && value !== undefined) parts.push(`${curve.short} ${this.number(value)}`);
    });
    if (y[0]?.[index] === null) parts.push(`${this.options.curves[0].short} ${NONE}`);
    if (quality?.[index]) parts.push(`quality ${quality[index]}`);
    if (this.series.marked?.[index]) parts.push("outlier");
    return parts.join(" · ");
  }

  /** @param {number} value */
  number(value) {
    return `${fixed(value, this.options.digits)}${this.options.unit ? ` ${this.options.unit}` : ""}`;
  }

  /** @param {number} index */
  showReadout(index) {
    setText(this.readout, index >= 0 && index < this.series.x.length ? this.describe(index) : "");
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    const steps = /** @type {Record<string, number>} */ ({ ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -1e9, End: 1e9 });
    const step = steps[event.key];
    if (step === undefined || !this.plot || !this.series.x.length) return;
    event.preventDefault();
    const last = this.series.x.length - 1;
    const from = this.cursor < 0 ? last : this.cursor;
    this.cursor = Math.max(0, Math.min(last, from + step));
    const left = this.plot.valToPos(this.series.x[this.cursor], "x");
    const value = this.series.y[0][this.cursor];
    this.plot.setCursor({ left, top: value === null ? 0 : this.plot.valToPos(value, "y") });
  }

  fillTable() {
    const { x, y, quality } = this.series;
    const curves = this.options.curves.map((curve, i) => ({ curve, i })).filter(({ curve }) => curve.tabled !== false);
    const head = el("tr", {}, el("th", { scope: "col", text: "Hour" }));
    for (const { curve } of curves) head.append(el("th", { scope: "col", text: `${curve.label}${this.options.unit ? ` (${this.options.unit})` : ""}` }));
    if (quality) head.append(el("th", { scope: "col", text: "Quality" }));
    const body = el("tbody");
    for (let k = x.length - 1; k >= Math.max(0, x.length - LONGEST_TABLE); k--) {
      const row = el("tr", {}, el("td", { text: fixed(x[k], 1) }));
      for (const { i } of curves) row.append(el("td", { text: fixed(y[i][k], this.options.digits) }));
      if (quality) row.append(el("td", { text: quality[k] ?? NONE }));
      body.append(row);
    }
    const caption = el("caption", { text: `${this.options.title}: ${x.length > LONGEST_TABLE ? `the newest ${LONGEST_TABLE} of ` : ""}${x.length} sets, newest first` });
    this.tableBox.replaceChildren(el("table", {}, caption, el("thead", {}, head), body));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvasBox;
    if (this.plot && width && height) this.plot.setSize({ width, height });
    else if (!this.plot && this.series?.x.length) this.draw();
  }

  destroy() {
    this.plot?.destroy();
    this.plot = null;
  }

  /** Draw anew, e.g. in the colours of another theme. */
  draw() {
    this.destroy();
    const { clientWidth: width, clientHeight: height } = this.canvasBox;
    if (!width || !height || !this.series.x.length) return;
    this.plot = new uPlot(this.plotOptions(width, height), this.data(), this.canvasBox);
  }

  /** @param {number} width @param {number} height @returns {any} */
  plotOptions(width, height) {
    const axis = {
      stroke: color("--quiet"),
      font: FONT,
      labelFont: FONT,
      grid: { stroke: color("--grid"), width: 1 },
      ticks: { stroke: color("--grid"), width: 1, size: 4 },
      labelGap: 2,
    };
    const log = Boolean(this.options.log);
    return {
      width,
      height,
      padding: [8, 12, 0, 0],
      legend: { show: false },
      cursor: { drag: { x: true, y: false }, points: { size: 8 }, focus: { prox: -1 } },
      scales: {
        x: { time: false, range: (/** @type {any} */ _u, /** @type {number} */ min, /** @type {number} */ max) => this.xRange(min, max) },
        y: { distr: log ? 3 : 1, range: (/** @type {any} */ _u, /** @type {number} */ min, /** @type {number} */ max) => this.yRange(min, max) },
      },
      axes: [
        { ...axis, label: "Time since start (h)", size: 26, labelSize: 20 },
        {
          ...axis,
          label: this.options.name,
          size: 58,
          labelSize: 18,
          ...(log
            ? {
                filter: decades,
                grid: { ...axis.grid, filter: decades },
                ticks: { ...axis.ticks, filter: decades },
                values: (/** @type {any} */ _u, /** @type {(number | null)[]} */ splits) => splits.map((v) => (v === null ? "" : v.toLocaleString("en"))),
              }
            : {}),
        },
      ],
      series: [{}, ...this.options.curves.map((curve) => this.curveOptions(curve))],
      hooks: {
        drawClear: [(/** @type {any} */ u) => this.drawBand(u)],
        draw: [(/** @type {any} */ u) => this.drawMarks(u)],
        setCursor: [
          (/** @type {any} */ u) => {
            this.cursor = u.cursor.idx ?? -1;
            this.showReadout(this.cursor < 0 ? this.series.x.length - 1 : this.cursor);
          },
        ],
      },
    };
  }

  /** @param {Curve} curve @returns {any} */
  curveOptions(curve) {
    const stroke = color(curve.color);
    if (curve.kind === "line") {
      return { label: curve.label, stroke, width: 2, dash: curve.dash, points: { show: false }, spanGaps: false };
    }
    const size = this.series.x.length > 250 ? 3.5 : 4.5;
    // The points speak; the line only leads from one to the next.
    return { label: curve.label, stroke: `${stroke}4d`, width: 1, spanGaps: false, points: { show: true, size, fill: stroke, width: 0, stroke } };
  }

  /** The axis grows in steps, so that a new set does not move everything. @param {number} min @param {number} max */
  xRange(min, max) {
    const zoomed = this.series.x.length > 1 && (min > this.series.x[0] || max < this.series.x[this.series.x.length - 1]);
    if (zoomed) return [min, max];
    const step = max <= 30 ? 6 : max <= 120 ? 24 : 50;
    return [0, Math.max(step, Math.min(Math.ceil((max * 1.02) / step) * step, Math.max(this.series.endHour, max)))];
  }

  /** @param {number | null} min @param {number | null} max */
  yRange(min, max) {
    if (min === null || max === null) return this.options.log ? [0.1, 100] : [0, 1];
    if (this.options.log) return [10 ** Math.floor(Math.log10(Math.max(min, 1e-3))), 10 ** Math.ceil(Math.log10(max * 1.05))];
    const pad = Math.max(0.08 * (max - min), 0.004 * Math.abs(max), 1e-9);
    return [min - pad, max + pad];
  }

  /** @param {any} u */
  drawBand(u) {
    const until = this.series.bandUntil;
    if (until === null || until === undefined) return;
    const { ctx, bbox } = u;
    const right = Math.min(u.valToPos(until, "x", true), bbox.left + bbox.width);
    const left = Math.max(u.valToPos(0, "x", true), bbox.left);
    if (right <= left) return;
    ctx.save();
    ctx.fillStyle = color("--band");
    ctx.fillRect(left, bbox.top, right - left, bbox.height);
    ctx.fillStyle = color("--good");
    ctx.font = `${11 * devicePixelRatio}px system-ui, "Liberation Sans", Arial, sans-serif`;
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    if (right - left > ctx.measureText("baseline").width + 8 * devicePixelRatio) {
      ctx.fillText("baseline", left + 4 * devicePixelRatio, bbox.top + 4 * devicePixelRatio);
    }
    ctx.restore();
  }

  /** Outliers as diamonds: shape beside colour. @param {any} u */
  drawMarks(u) {
    const { marked, x, y } = this.series;
    if (!marked) return;
    const { ctx, bbox } = u;
    const size = 4 * devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.fillStyle = color("--alarm");
    for (let k = 0; k < x.length; k++) {
      const value = y[0][k];
      if (!marked[k] || value === null) continue;
      const px = u.valToPos(x[k], "x", true);
      const py = u.valToPos(value, "y", true);
      ctx.beginPath();
      ctx.moveTo(px, py - size);
      ctx.lineTo(px + size, py);
      ctx.lineTo(px, py + size);
      ctx.lineTo(px - size, py);
      ctx.fill();
    }
    ctx.restore();
  }

  /** What is drawn, for tests and for the curious; copies. */
  snapshot() {
    return {
      x: [...this.series.x],
      y: Object.fromEntries(this.options.curves.map((curve, i) => [curve.key, [...this.series.y[i]]])),
      drawn: Boolean(this.plot),
    };
  }
}
