// Show a trend over the hours of the test: a plot, a table of the same numbers for those who do not see
// it, keys for those without a pointer; each point opens its set.

import { button, color, el, setText } from "../dom.js";
import { chartOffer, exportMenu } from "../export.js";
import { NONE, fixed } from "../format.js";
import { onZoomKey, within } from "./gestures.js";
import { swatch } from "./legend.js";
import { dataOf, makePlot } from "./plot.js";

/**
 * @typedef {object} ChartOptions
 * @property {string} title
 * @property {boolean} [log]
 * @property {string} empty text without data
 *
 * @typedef {object} Series
 * @property {number[]} x hours
 * @property {import("./series.js").Line[]} lines the first one is the measured one
 * @property {string} name what the y axis shows, with its unit
 * @property {string} unit
 * @property {number} digits of the read-out
 * @property {import("./marks.js").Range[]} ranges
 * @property {number[]} alarms hours
 * @property {number | null} opened hour of the opened set
 * @property {string} subtitle
 * @property {{fields: string[], method: string, positions: string[]} | null} exported data of the API that it shows
 *
 * @typedef {object} Host what all charts of the page share
 * @property {() => import("./gestures.js").Span | null} span null: the complete test
 * @property {() => import("./gestures.js").Span} full hours of the complete test; a chart adds those of its forecast
 * @property {(span: import("./gestures.js").Span | null, gesture?: boolean) => void} show
 * @property {() => import("../timeline.js").Timeline} timeline
 * @property {(position: string, setIndex: number) => void} open
 * @property {(id: string, shown: boolean) => void} table
 * @property {(hour: number, ask: boolean) => void} note the pointer is at an hour, or the user annotates it
 */

const MAX_TABLE_ROWS = 500;
/**
 * Return the marks that a chart has: one entry of its legend each, however often it is drawn.
 *
 * @param {Series} series
 * @returns {[string, "diamond" | "cross" | "ring" | "line" | "dashed", string][]} color, kind and label
 */
function marksIn({ lines, ranges }) {
  const has = (/** @type {string} */ quality) => lines.some((line) => line.quality?.includes(quality));
  // With several positions a mark has the color of each.
  const color = lines.filter((line) => line.points).length > 1 ? "--ink" : "--data";
  const labels = new Map(ranges.filter((range) => range.inLegend).map(({ label, tone }) => [label, tone]));
  /** @type {ReturnType<typeof marksIn>} */
  const marks = [...labels].map(([label, tone]) => [`--${tone}`, "line", label]);
  if (lines.some((line) => line.forecast)) marks.push([color, "dashed", "forecast, 5 to 95 %"]);
  if (has("suspect")) marks.unshift([color, "ring", "suspect"]);
  if (has("bad")) marks.unshift(["--alarm", "cross", "bad"]);
  if (lines.some((line) => line.outlier?.includes(true))) marks.unshift([color, "diamond", "outlier"]);
  return marks;
}

/** @type {Series} */
const NOTHING = {
  x: [],
  lines: [],
  name: "",
  unit: "",
  digits: 0,
  ranges: [],
  alarms: [],
  opened: null,
  subtitle: "",
  exported: null,
};

export class SolimonChart extends HTMLElement {
  constructor() {
    super();
    /** @type {ChartOptions} */
    this.options = { title: "", empty: "" };
    /** @type {Host} */
    this.host = /** @type {any} */ (null);
    this.series = NOTHING;
    /** @type {any} */
    this.plot = null;
    this.detach = () => {};
    /** Lines, unit and axis that the plot was made for. */
    this.made = "";
    /** Index under the pointer or the keyboard's cursor, or -1. @type {number} */
    this.cursor = -1;
    this.heading = el("h2");
    this.subtitle = el("p");
    this.toggle = el("button", { class: "button ghost small", type: "button", "aria-pressed": "false", text: "Table" });
    this.actions = el("div", { class: "card-actions" }, this.toggle);
    this.readout = el("p", { class: "readout", "aria-live": "polite" });
    this.canvasBox = el("div", { class: "plot", tabindex: "0", role: "img" });
    this.emptyText = el("p", { class: "empty", text: "Loading" });
    this.canvasBox.append(this.emptyText);
    this.tableBox = el("div", { class: "table-wrap", tabindex: "0", role: "region", hidden: true });
    this.legend = el("ul", { class: "legend" });
    this.toggle.addEventListener("click", () => this.host.table(this.id, this.tableBox.hidden));
    this.canvasBox.addEventListener("keydown", (event) => this.onKey(event));
    /** Whether it is on the screen: off screen, another span is drawn when it gets there, new data at once. */
    this.visible = true;
    this.pending = false;
    new ResizeObserver(() => this.resize()).observe(this.canvasBox);
    new IntersectionObserver((entries) => {
      this.visible = entries[entries.length - 1].isIntersecting;
      if (this.visible) this.drawPending();
    }).observe(this.canvasBox);
    addEventListener("beforeprint", () => this.drawPending());
  }

  /** @param {ChartOptions} options @param {Host} host */
  configure(options, host) {
    this.options = options;
    const ahead = () => this.series.lines.map((line) => line.forecast?.hours[1] ?? 0);
    this.host = { ...host, full: () => [0, Math.max(host.full()[1], ...ahead())] };
    this.heading.id = `${this.id}-title`;
    setText(this.heading, options.title);
    this.toggle.setAttribute("aria-label", `Table of: ${options.title}`);
    this.actions.append(
      button("PNG", () => this.savePicture(), { "aria-label": `Save as PNG: ${options.title}` }),
      exportMenu(options.title, () => this.series.exported && chartOffer(this.series.exported, host.span())),
    );
    this.tableBox.setAttribute("aria-label", `${options.title}, table`);
    this.canvasBox.setAttribute("aria-label", `${options.title}. ${this.emptyText.textContent}`);
    this.setAttribute("role", "group");
    this.setAttribute("aria-labelledby", this.heading.id);
    this.append(
      el("div", { class: "card-head" }, el("div", {}, this.heading, this.subtitle), this.actions),
      this.readout,
      this.canvasBox,
      this.tableBox,
      this.legend,
    );
  }

  /** Set the title to the feature that it shows now. @param {string} title */
  setTitle(title) {
    this.options = { ...this.options, title };
    setText(this.heading, title);
  }

  /** Download what is drawn as a PNG, with title, subtitle and the names of the lines above it. */
  savePicture() {
    if (!this.plot) return;
    const { canvas: drawn } = this.plot.ctx;
    const line_px = 18 * devicePixelRatio;
    const canvas = /** @type {HTMLCanvasElement} */ (el("canvas"));
    Object.assign(canvas, { width: drawn.width, height: drawn.height + 3.5 * line_px });
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    pen.fillStyle = color("--surface");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(drawn, 0, 3.5 * line_px);
    pen.font = `${12 * devicePixelRatio}px sans-serif`;
    const write = (/** @type {string} */ text, /** @type {string} */ name, /** @type {number} */ row, left_px = 8) => {
      pen.fillStyle = color(name);
      pen.fillText(text, left_px, row * line_px);
      return left_px + pen.measureText(`${text}   `).width;
    };
    write(this.options.title, "--ink", 1);
    write(this.series.subtitle, "--quiet", 2);
    this.series.lines.reduce((left_px, line) => write(line.label, line.color, 3, left_px), 8);
    el("a", { download: `${this.id}.png`, href: canvas.toDataURL() }).click();
  }

  /** @param {boolean} shown */
  showTable(shown) {
    if (shown === !this.tableBox.hidden) return;
    this.tableBox.hidden = !shown;
    this.canvasBox.hidden = shown;
    this.toggle.setAttribute("aria-pressed", String(shown));
    if (shown) this.fillTable();
  }

  /** @param {Series} series */
  update(series) {
    this.series = series;
    const [first] = series.lines;
    this.dataset.points = String(first ? first.y.filter((value) => value !== null).length : 0);
    setText(this.subtitle, series.subtitle);
    this.subtitle.title = series.subtitle;
    setText(this.emptyText, this.options.empty);
    this.emptyText.hidden = series.x.length > 0;
    const last = series.x.length - 1;
    this.canvasBox.setAttribute(
      "aria-label",
      `${this.options.title}. ${series.subtitle}. ${series.x.length} sets; arrow keys read single ` +
        "values, Enter opens the set, N adds a note. " +
        `${last >= 0 ? this.describe(last) : this.options.empty}`,
    );
    if (this.cursor < 0 || this.cursor > last) this.showReadout(last);
    const marks = marksIn(series);
    const made = JSON.stringify([
      series.name,
      marks,
      this.host.timeline().label,
      series.lines.map((line) => [line.key, line.label, line.color]),
    ]);
    if (made !== this.made) {
      // A single position needs no name: the title has it.
      const named = series.lines.filter((line) => line !== first || !line.points || series.lines[1]?.points);
      this.legend.replaceChildren(
        ...named.map((line) =>
          el(
            "li",
            {},
            swatch(line.color, line.points && !line.dash ? (line.shape ?? 0) : "line", line.dash),
            line.label,
          ),
        ),
        ...marks.map(([color, kind, label]) => el("li", {}, swatch(color, kind), label)),
      );
    }
    // Draw last, when all surrounding elements have their size.
    if (!series.x.length) this.destroy();
    else if (this.plot && made === this.made) {
      this.plot.setData(dataOf(series));
      this.pending = false;
    } else this.draw();
    this.made = made;
    if (!this.tableBox.hidden) this.fillTable();
  }

  /** Show the current span and opened set. */
  applySpan() {
    if (!this.visible) this.pending = true;
    else if (this.plot) this.plot.setScale("x", this.plot.scales.x);
  }

  /** Draw now what was postponed off screen. */
  drawPending() {
    if (this.pending && this.plot) this.plot.batch(() => this.plot.setData(dataOf(this.series)));
    this.pending = false;
  }

  /** @param {number} index */
  describe(index) {
    const { x, lines } = this.series;
    const parts = [`hour ${fixed(x[index], 1)}`, this.host.timeline().text(x[index])];
    for (const line of lines) {
      const value = line.y[index];
      if (value !== null && value !== undefined) parts.push(`${line.short} ${this.number(value)}`);
      else if (line === lines[0]) parts.push(`${line.short} ${NONE}`);
      if (line.quality?.[index] && (line === lines[0] || line.quality[index] !== "good"))
        parts.push(`quality ${line.quality[index]}`);
      if (line.outlier?.[index]) parts.push("outlier");
    }
    return parts.filter(Boolean).join(" · ");
  }

  /** @param {number} value */
  number(value) {
    return `${fixed(value, this.series.digits)}${this.series.unit ? ` ${this.series.unit}` : ""}`;
  }

  /** @param {number} index */
  showReadout(index) {
    setText(this.readout, index >= 0 && index < this.series.x.length ? this.describe(index) : "");
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    if (!this.plot || !this.series.x.length) return;
    const { x, lines } = this.series;
    const at = this.cursor < 0 ? x.length - 1 : this.cursor;
    const { full } = this.host;
    const span = () => this.host.span() ?? full();
    if (onZoomKey(event, { span, full, show: (to) => this.host.show(to, true), center: () => x[at] })) return;
    if (event.key === "Enter" || event.key === "n") {
      event.preventDefault();
      if (event.key === "n") this.host.note(x[at], true);
      else this.open(lines[0], at);
      return;
    }
    const steps = /** @type {Record<string, number>} */ ({
      ArrowLeft: -1,
      ArrowRight: 1,
      PageUp: -10,
      PageDown: 10,
      Home: -1e9,
      End: 1e9,
    });
    const step = steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    this.cursor = Math.max(0, Math.min(x.length - 1, at + step));
    const [from, to] = span();
    const outside = x[this.cursor] < from || x[this.cursor] > to;
    if (outside)
      this.host.show(within([x[this.cursor] - (to - from) / 2, x[this.cursor] + (to - from) / 2], full()), true);
    this.point(this.cursor);
  }

  /** Move the cursor of all charts to a set. @param {number} index */
  point(index) {
    const { x, lines } = this.series;
    const value = lines[0].y[index];
    this.plot.setCursor(
      { left: this.plot.valToPos(x[index], "x"), top: value === null ? 0 : this.plot.valToPos(value, "y") },
      true,
      true,
    );
  }

  /** Open the set whose point is closest to the pointer. @param {any} plot */
  openNearest(plot) {
    const index = plot.cursor.idx;
    if (index === null || index === undefined) return;
    const away = (/** @type {import("./series.js").Line} */ line) => {
      const value = line.y[index];
      return value === null ? Infinity : Math.abs(plot.valToPos(value, "y") - plot.cursor.top);
    };
    const lines = this.series.lines.filter((line) => line.sets?.[index] !== null && line.sets?.[index] !== undefined);
    lines.sort((a, b) => away(a) - away(b));
    this.open(lines[0], index);
  }

  /** @param {import("./series.js").Line | undefined} line @param {number} index */
  open(line, index) {
    const set = line?.sets?.[index];
    if (line?.position && set !== null && set !== undefined) this.host.open(line.position, set);
  }

  fillTable() {
    const { x, lines, unit } = this.series;
    const head = el("tr", {}, el("th", { scope: "col", text: "Hour" }));
    for (const line of lines) head.append(el("th", { scope: "col", text: `${line.label}${unit ? ` (${unit})` : ""}` }));
    const [first] = lines;
    if (first?.quality) head.append(el("th", { scope: "col", text: "Quality" }));
    const body = el("tbody");
    const [from, to] = this.host.span() ?? [-Infinity, Infinity];
    const rows = [...x.keys()].filter((k) => x[k] >= from && x[k] < to).reverse();
    for (const k of rows.slice(0, MAX_TABLE_ROWS)) {
      const openButton = el("button", {
        class: "link",
        type: "button",
        text: fixed(x[k], 1),
        "aria-label": `Open the set of hour ${fixed(x[k], 1)}`,
      });
      openButton.addEventListener("click", () => this.open(first, k));
      const row = el("tr", {}, el("td", {}, openButton));
      for (const line of lines) row.append(el("td", { text: fixed(line.y[k], this.series.digits) }));
      if (first.quality) row.append(el("td", { text: first.quality[k] ?? NONE }));
      body.append(row);
    }
    const caption = el("caption", {
      text:
        `${this.options.title}: ` +
        `${rows.length > MAX_TABLE_ROWS ? `the newest ${MAX_TABLE_ROWS} of ` : ""}${rows.length} sets, ` +
        "newest first",
    });
    this.tableBox.replaceChildren(el("table", {}, caption, el("thead", {}, head), body));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvasBox;
    if (this.plot && width && height) {
      this.drawPending();
      this.plot.setSize({ width, height });
    } else if (!this.plot && this.series.x.length) this.draw();
  }

  destroy() {
    this.detach();
    this.plot?.destroy();
    this.plot = null;
    this.detach = () => {};
  }

  /** Draw again, e.g. in the colors of another theme. */
  draw() {
    this.destroy();
    this.pending = false;
    if (!this.canvasBox.clientWidth || !this.canvasBox.clientHeight || !this.series.x.length) return;
    const handlers = {
      onCursor: (/** @type {number} */ index) => {
        this.cursor = index;
        if (index >= 0) this.host.note(this.series.x[index], false);
        this.showReadout(index < 0 ? this.series.x.length - 1 : index);
      },
      onClick: (/** @type {any} */ plot) => this.openNearest(plot),
    };
    ({ plot: this.plot, detach: this.detach } = makePlot(
      this.canvasBox,
      this.options,
      this.host,
      () => this.series,
      handlers,
    ));
  }

  /** Return copies of what is drawn, for tests and the console. */
  snapshot() {
    this.drawPending();
    return {
      x: [...this.series.x],
      y: Object.fromEntries(this.series.lines.map((line) => [line.key, [...line.y]])),
      span: this.plot ? [this.plot.scales.x.min, this.plot.scales.x.max] : null,
      forecasts: this.series.lines.flatMap((line) => line.forecast ?? []),
      low: [...(this.series.lines[0]?.low ?? [])],
      opens: [...(this.series.lines[0]?.sets ?? [])],
      ranges: this.series.ranges.map((range) => ({ ...range })),
      cursor: this.cursor,
      drawn: Boolean(this.plot),
    };
  }
}
