// All records of the chosen position over the test as one picture: an inspector's B-scan. Hours are those of
// the charts; what is drawn over it can be switched; each place leads to its set.

import { swatch } from "../charts/legend.js";
import { button, el, setText } from "../dom.js";
import { significant } from "../format.js";
import { drawAxes } from "./axes.js";
import { palette, themeNow } from "./colours.js";
import { attach } from "./gestures.js";
import { badHoursOf, tracksOf } from "./marks.js";
import { paint, paintOver } from "./paint.js";
import { setAt } from "./image.js";
import { PictureReading } from "./image-loader.js";
import { tableOf } from "./table.js";
import { anchorOf, labelOf, readoutOf, subtitleOf, thicknessOf } from "./labels.js";

/** @typedef {import("./image.js").Picture} Picture @typedef {import("./labels.js").Span} Span @typedef {import("./labels.js").Cursor} Cursor */
/**
 * @typedef {object} Host
 * @property {() => any} info null: the chosen position is not known yet
 * @property {() => import("../view.js").View} view
 * @property {(part: Partial<import("../view.js").View>, how?: {gesture?: boolean}) => void} go
 * @property {() => Span} whole hours of the test
 * @property {() => import("../timeline.js").Timeline} timeline
 * @property {(position: string, set: number) => void} open
 * @property {(position: string) => Omit<import("./paint.js").Over, "tracks" | "bad">} over
 * @property {(position: string, fields: string[], range: Record<string, number>) => Promise<any>} trend
 * @property {() => boolean} hasBaseline whether the chosen position has one
 */

const MOST_ROWS = 512;
const MOST_COLUMNS = 1024;
const GUTTER = { left: 58, right: 12, rightOfThickness: 54, top: 6, bottom: 40, bottomOfDates: 54 };
const SHOWN = { volts: "Volts", normalised: "Normalised", difference: "Difference from the baseline" };
const OVER = { tracks: "Tracks", alarms: "Alarms", gaps: "Missing sets", bad: "Bad sets" };

/** @param {string} label @param {(value: string) => void} act */
function choice(label, act) {
  const made = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": label }));
  made.addEventListener("change", () => act(made.value));
  return made;
}

/** @param {HTMLSelectElement} select @param {Record<string, string>} options @param {string} value */
function offer(select, options, value) {
  const made = JSON.stringify(options);
  if (select.dataset.made !== made) select.replaceChildren(...Object.entries(options).map(([key, text]) => el("option", { value: key, text })));
  select.dataset.made = made;
  select.value = value;
}

/** @param {string[]} list @param {string} one with it where it was without, and the other way round */
const toggled = (list, one) => (list.includes(one) ? list.filter((other) => other !== one) : [...list, one]);

/** @param {string} name @param {Record<string, string>} [size] */
const canvas = (name, size) => /** @type {HTMLCanvasElement} */ (el("canvas", { class: `waterfall-${name}`, ...size }));

/** @param {HTMLCanvasElement} canvas */
const contextOf = (canvas) => /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));

export class SolimonWaterfall extends HTMLElement {
  constructor() {
    super();
    /** @type {Host} */
    this.host = /** @type {any} */ (null);
    this.reading = new PictureReading(() => this.wanted(), (position, fields, range) => this.host.trend(position, fields, range), () => this.draw());
    /** @type {import("./axes.js").Box | null} */
    this.lastArea = null;
    /** Under the pointer or the keys. @type {Cursor | null} */
    this.cursor = null;
    this.heading = el("h2", { id: "waterfall-title", text: "Waterfall" });
    this.subtitle = el("p");
    this.readout = el("p", { class: "readout", "aria-live": "polite" });
    this.align = choice("Time counts from", (align) => this.host.go({ align: /** @type {any} */ (align), from_wf_us: null, to_wf_us: null }));
    this.shown = choice("Values of the waterfall", (shown) => this.host.go({ shown: /** @type {any} */ (shown) }));
    this.whole = button("Whole record", () => this.host.go({ from_wf_us: null, to_wf_us: null }));
    this.toggle = button("Table", () => this.host.go({ tables: toggled(this.host.view().tables, "waterfall") }), { "aria-label": "Table of: Waterfall" });
    this.overs = Object.entries(OVER).map(([key, text]) => button(text, () => this.host.go({ hides: toggled(this.host.view().hides, key) }), { "data-over": key }));
    this.box = el("div", { class: "plot waterfall", tabindex: "0", role: "img", "aria-label": "Waterfall" });
    this.image = canvas("image");
    this.over = canvas("over");
    this.axes = canvas("axes");
    this.cross = [el("span", { class: "waterfall-cross across", hidden: true }), el("span", { class: "waterfall-cross down", hidden: true })];
    this.emptyText = el("p", { class: "empty", text: "Reading" });
    this.box.append(this.axes, this.image, this.over, ...this.cross, this.emptyText);
    this.tableBox = el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": "Waterfall, table", hidden: true });
    this.scale = canvas("scale", { width: "255", height: "1" });
    this.legend = el("ul", { class: "legend" });
    attach(this.box, {
      hours: { span: () => this.hours(), whole: () => this.host.whole(), show: (span) => this.host.go({ from_h: span?.[0] ?? null, to_h: span?.[1] ?? null }, { gesture: true }) },
      seconds: { span: () => this.seconds(), whole: () => this.wholeSeconds(), show: (span) => this.host.go({ from_wf_us: span ? span[0] * 1e6 : null, to_wf_us: span ? span[1] * 1e6 : null }, { gesture: true }) },
      place: () => this.over.getBoundingClientRect(),
      header: () => this.picture?.header,
      cursor: () => this.cursor,
      point: (cursor) => {
        this.cursor = cursor;
        this.showCursor();
      },
      open: () => this.openHere(),
    });
    new ResizeObserver(() => this.update()).observe(this.box);
  }

  connectedCallback() {
    this.setAttribute("role", "group");
    this.setAttribute("aria-labelledby", "waterfall-title");
    const actions = el("div", { class: "card-actions wrap" }, this.align, this.shown, ...this.overs, this.whole, this.toggle);
    this.append(el("div", { class: "card-head" }, el("div", {}, this.heading, this.subtitle)), actions, this.readout, this.box, this.tableBox, this.legend);
  }

  get picture() {
    return this.reading.picture;
  }

  tabled() {
    return this.host.view().tables.includes("waterfall");
  }

  /** How the chosen position is measured; undefined: it is not known yet. @returns {string | undefined} */
  get method() {
    return this.host?.info()?.positions.find((/** @type {any} */ place) => place.position === this.host.view().position)?.method;
  }

  /** @returns {Span} */
  hours() {
    const { from_h, to_h } = this.host.view();
    return from_h === null || to_h === null ? this.host.whole() : [from_h, to_h];
  }

  /** Times that there are. @returns {Span} seconds */
  wholeSeconds() {
    return this.picture?.header.whole_s ?? [0, 1];
  }

  /** @returns {Span} */
  seconds() {
    const { from_wf_us, to_wf_us } = this.host.view();
    return from_wf_us === null || to_wf_us === null ? this.wholeSeconds() : [from_wf_us / 1e6, to_wf_us / 1e6];
  }

  /** Show what the view says; called after every change of it, and of what was read. */
  update() {
    const { method } = this;
    if (!method) return;
    const view = this.host.view();
    offer(this.align, { trigger: "From the trigger", first: `From the ${method === "pulse_echo" ? "first echo" : "ISW"}` }, view.align);
    offer(this.shown, SHOWN, view.shown);
    for (const one of this.overs) one.setAttribute("aria-pressed", String(!view.hides.includes(one.dataset.over ?? "")));
    this.whole.disabled = view.from_wf_us === null;
    setText(this.heading, `Waterfall · ${view.position}`);
    this.toggle.setAttribute("aria-pressed", String(this.tabled()));
    this.tableBox.hidden = !this.tabled();
    this.box.hidden = this.tabled();
    if (this.picture && this.picture.header.position !== view.position) this.reading.picture = null;
    this.draw();
    this.reading.schedule();
  }

  /** Something may be new. @param {string} newest what there is of the position */
  renew(newest) {
    this.reading.renew(newest);
    this.update();
  }

  /** @returns {import("./image-loader.js").Question | null} */
  wanted() {
    const { method } = this;
    if (!method) return null;
    const { position, align, shown, from_wf_us, to_wf_us } = this.host.view();
    const area = this.area();
    const [from, to] = this.hours();
    const first = method === "pulse_echo" ? "first_echo" : "isw";
    const query = {
      // Rows at both edges reach beyond them.
      from_h: from - 0.02 * (to - from),
      to_h: to + 0.02 * (to - from),
      from_s: from_wf_us === null ? null : from_wf_us / 1e6,
      to_s: to_wf_us === null ? null : to_wf_us / 1e6,
      align: align === "first" ? first : "trigger",
      as: shown,
      rows: Math.min(MOST_ROWS, Math.max(16, Math.round(area.width * devicePixelRatio))),
      columns: Math.min(MOST_COLUMNS, Math.max(16, Math.round(area.height * devicePixelRatio))),
    };
    const without = shown === "difference" && !this.host.hasBaseline() ? `Position ${position} has no baseline yet to differ from` : "";
    return { position, method, query, without };
  }

  /** Where the picture is in the box, in CSS pixels. */
  area() {
    // Behind a table nothing has a size; the picture stays as it was asked for.
    if (!this.box.clientWidth && this.lastArea) return this.lastArea;
    const right = this.method === "pulse_echo" ? GUTTER.rightOfThickness : GUTTER.right;
    const bottom = this.host.timeline().axis === "hours" ? GUTTER.bottom : GUTTER.bottomOfDates;
    return (this.lastArea = { left: GUTTER.left, top: GUTTER.top, width: Math.max(1, this.box.clientWidth - GUTTER.left - right), height: Math.max(1, this.box.clientHeight - GUTTER.top - bottom) });
  }

  draw() {
    const { picture } = this;
    const { trouble } = this.reading;
    const drawn = Boolean(picture?.header.rows);
    setText(this.emptyText, trouble || (picture ? "No record in these hours" : "Reading"));
    this.emptyText.hidden = drawn;
    this.image.hidden = this.over.hidden = this.axes.hidden = !drawn;
    this.dataset.drawn = picture ? String(picture.header.rows) : "";
    if (!drawn || !picture) return;
    if (this.box.clientWidth) this.drawPicture(picture);
    this.describe(picture.header);
    if (this.tabled()) this.tableBox.replaceChildren(tableOf(picture, (set) => this.host.open(picture.header.position, set)));
  }

  /** @param {Picture} picture */
  drawPicture(picture) {
    const area = this.area();
    const ratio = devicePixelRatio;
    for (const canvas of [this.image, this.over]) {
      Object.assign(canvas.style, { left: `${area.left}px`, top: `${area.top}px`, width: `${area.width}px`, height: `${area.height}px` });
      canvas.width = Math.round(area.width * ratio);
      canvas.height = Math.round(area.height * ratio);
    }
    const { header } = picture;
    const [hours, seconds] = [this.hours(), this.seconds()];
    paint(contextOf(this.image), picture, hours, seconds, this.reading.limit);
    this.axes.width = Math.round(this.box.clientWidth * ratio);
    this.axes.height = Math.round(this.box.clientHeight * ratio);
    const axes = contextOf(this.axes);
    axes.scale(ratio, ratio);
    const micros = /** @type {Span} */ (seconds.map((value) => value * 1e6));
    drawAxes(axes, area, hours, { span: micros, label: `Time from the ${anchorOf(header)} (µs)` }, thicknessOf(header, seconds), this.host.timeline());
    const { hides } = this.host.view();
    const over = this.host.over(header.position);
    const marks = {
      tracks: hides.includes("tracks") ? [] : this.tracks(),
      bad: hides.includes("bad") ? [] : badHoursOf(this.reading.columns),
      alarms: hides.includes("alarms") ? [] : over.alarms,
      gaps: hides.includes("gaps") ? [] : over.gaps,
      opened: over.opened,
    };
    paintOver(contextOf(this.over), marks, hours, seconds);
    this.showCursor();
  }

  tracks() {
    return this.picture ? tracksOf(this.picture.header, this.reading.columns) : [];
  }

  /** @param {any} header */
  describe(header) {
    setText(this.subtitle, subtitleOf(header));
    this.box.setAttribute("aria-label", labelOf(header));
    const colours = palette(themeNow());
    const image = new ImageData(colours.length, 1);
    new Uint32Array(image.data.buffer).set(colours);
    contextOf(this.scale).putImageData(image, 0, 0);
    const { limit } = this.reading;
    const ends = [-limit, limit].map((value) => `${significant(value)} ${header.unit === "V" ? "V" : "of the row's greatest"}`);
    this.legend.replaceChildren(
      el("li", {}, ends[0], this.scale, ends[1]),
      el("li", {}, el("span", { class: "waterfall-none" }), "no record"),
      ...this.tracks().map((track) => el("li", {}, swatch(track.color, "line", track.dash), track.label)),
      el("li", {}, swatch("--alarm", "cross"), "bad set"),
    );
  }

  showCursor() {
    const { cursor, picture } = this;
    const area = this.area();
    const [hours, seconds] = [this.hours(), this.seconds()];
    for (const line of this.cross) line.hidden = !cursor;
    if (!cursor || !picture) return setText(this.readout, "");
    const [across, down] = this.cross;
    Object.assign(down.style, { left: `${area.left + ((cursor.hour - hours[0]) / (hours[1] - hours[0])) * area.width}px`, top: `${area.top}px`, height: `${area.height}px` });
    Object.assign(across.style, { top: `${area.top + ((cursor.seconds - seconds[0]) / (seconds[1] - seconds[0])) * area.height}px`, left: `${area.left}px`, width: `${area.width}px` });
    setText(this.readout, readoutOf(picture, cursor, this.host.timeline()));
  }

  /** The set at the cursor. */
  openHere() {
    const { picture, cursor } = this;
    const set = picture && cursor ? setAt(picture.header, cursor.hour) : null;
    if (picture && set !== null) this.host.open(picture.header.position, set);
  }

  /** What is drawn, for tests and for the curious; copies. */
  snapshot() {
    if (!this.method) return { ready: false };
    return { header: structuredClone(this.picture?.header ?? null), limit: this.reading.limit, hours: this.hours(), seconds: this.seconds(), tracks: structuredClone(this.tracks()), cursor: this.cursor, ready: this.reading.settled };
  }
}
