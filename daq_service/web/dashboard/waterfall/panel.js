// All records of the chosen position over the test as one picture: an inspector's B-scan. Hours are those of
// the charts; what is drawn over it can be switched; each place leads to its set.

import { onZoomKey, panned, within, zoomed } from "../charts/gestures.js";
import { swatch } from "../charts/legend.js";
import { el, setText } from "../dom.js";
import { fixed, significant } from "../format.js";
import { drawAxes } from "./axes.js";
import { palette, themeNow } from "./colours.js";
import { paint, paintOver } from "./paint.js";
import { columnAt, extreme, greatestOf, readPicture, rowAt } from "./picture.js";

/** @typedef {import("./picture.js").Picture} Picture @typedef {[number, number]} Span */
/**
 * @typedef {object} Host
 * @property {() => any} info null: the chosen position is not known yet
 * @property {() => import("../view.js").View} view
 * @property {(part: Partial<import("../view.js").View>, how?: {gesture?: boolean}) => void} go
 * @property {() => Span} whole hours of the test
 * @property {() => import("../time.js").Timeline} timeline
 * @property {(position: string, set: number) => void} open
 * @property {(position: string) => Omit<import("./paint.js").Over, "tracks" | "bad">} over
 * @property {(position: string, fields: string[], range: Record<string, number>) => Promise<any>} trend
 */

const READ_MS = 120;
const GO_ON_MS = 400;
const MOST_ROWS = 512;
const MOST_COLUMNS = 1024;
const LONGEST_TABLE = 200;
const GUTTER = { left: 58, right: 12, rightOfThickness: 54, top: 6, bottom: 40, bottomOfDates: 54 };
const TRACKS = /** @type {Record<string, {field: string, label: string, color: string, dash: number[]}[]>} */ ({
  solitary_wave: [
    { field: "isw_time_s", label: "ISW", color: "--ink", dash: [] },
    { field: "psw_time_s", label: "PSW", color: "--good", dash: [8, 3] },
    { field: "ssw_time_s", label: "SSW", color: "--second", dash: [3, 3] },
  ],
  pulse_echo: [{ field: "travel_time_s", label: "first echo", color: "--ink", dash: [] }],
});
const SHOWN = { volts: "Volts", normalised: "Normalised", difference: "Difference from the baseline" };
const OVER = { tracks: "Tracks", alarms: "Alarms", gaps: "Missing sets", bad: "Bad sets" };

export class SolimonWaterfall extends HTMLElement {
  constructor() {
    super();
    /** @type {Host} */
    this.host = /** @type {any} */ (null);
    /** @type {Picture | null} */
    this.picture = null;
    /** @type {any} columns beside it */
    this.marks = null;
    this.limit = 0;
    this.asked = "";
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    this.trouble = "";
    /** @type {import("./axes.js").Box | null} */
    this.lastArea = null;
    /** Sets that the picture before lacked. */
    this.pending = Infinity;
    /** What there is of the position: a picture of less is asked for again. */
    this.newest = "";
    /** Hour and seconds under the pointer or the keys. @type {{hour: number, seconds: number} | null} */
    this.cursor = null;
    this.heading = el("h2", { id: "waterfall-title", text: "Waterfall" });
    this.subtitle = el("p");
    this.readout = el("p", { class: "readout", "aria-live": "polite" });
    this.align = this.choice("Time counts from", (align) => this.host.go({ align: /** @type {any} */ (align), from_wf_us: null, to_wf_us: null }));
    this.shown = this.choice("Values of the waterfall", (shown) => this.host.go({ shown: /** @type {any} */ (shown) }));
    this.whole = this.button("Whole record", () => this.host.go({ from_wf_us: null, to_wf_us: null }));
    this.toggle = this.button("Table", () => this.host.go({ tables: this.tabled() ? this.host.view().tables.filter((id) => id !== "waterfall") : [...this.host.view().tables, "waterfall"] }));
    this.toggle.setAttribute("aria-label", "Table of: Waterfall");
    this.overs = Object.entries(OVER).map(([key, text]) => {
      const hides = () => this.host.view().hides;
      const button = this.button(text, () => this.host.go({ hides: hides().includes(key) ? hides().filter((one) => one !== key) : [...hides(), key] }));
      button.dataset.over = key;
      return button;
    });
    this.box = el("div", { class: "plot waterfall", tabindex: "0", role: "img", "aria-label": "Waterfall" });
    this.image = /** @type {HTMLCanvasElement} */ (el("canvas", { class: "waterfall-image" }));
    this.over = /** @type {HTMLCanvasElement} */ (el("canvas", { class: "waterfall-over" }));
    this.axes = /** @type {HTMLCanvasElement} */ (el("canvas", { class: "waterfall-axes" }));
    this.cross = [el("span", { class: "waterfall-cross across", hidden: true }), el("span", { class: "waterfall-cross down", hidden: true })];
    this.emptyText = el("p", { class: "empty", text: "Reading" });
    this.box.append(this.axes, this.image, this.over, ...this.cross, this.emptyText);
    this.tableBox = el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": "Waterfall, table", hidden: true });
    this.scale = /** @type {HTMLCanvasElement} */ (el("canvas", { class: "waterfall-scale", width: "255", height: "1" }));
    this.legend = el("ul", { class: "legend" });
    this.gestures();
    new ResizeObserver(() => this.update()).observe(this.box);
  }

  connectedCallback() {
    this.setAttribute("role", "group");
    this.setAttribute("aria-labelledby", "waterfall-title");
    const actions = el("div", { class: "card-actions wrap" }, this.align, this.shown, ...this.overs, this.whole, this.toggle);
    this.append(el("div", { class: "card-head" }, el("div", {}, this.heading, this.subtitle)), actions, this.readout, this.box, this.tableBox, this.legend);
  }

  /** @param {string} text @param {() => void} act */
  button(text, act) {
    const made = /** @type {HTMLButtonElement} */ (el("button", { class: "button ghost small", type: "button", text }));
    made.addEventListener("click", act);
    return made;
  }

  /** @param {string} label @param {(value: string) => void} act */
  choice(label, act) {
    const made = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": label }));
    made.addEventListener("change", () => act(made.value));
    return made;
  }

  tabled() {
    return this.host.view().tables.includes("waterfall");
  }

  get method() {
    return this.host.info().positions.find((/** @type {any} */ place) => place.position === this.host.view().position)?.method;
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
    if (!this.host?.info() || !this.method) return;
    const view = this.host.view();
    const first = this.method === "pulse_echo" ? "first echo" : "ISW";
    this.options(this.align, { trigger: "From the trigger", first: `From the ${first}` }, view.align);
    this.options(this.shown, SHOWN, view.shown);
    for (const button of this.overs) button.setAttribute("aria-pressed", String(!view.hides.includes(button.dataset.over ?? "")));
    this.whole.disabled = view.from_wf_us === null;
    setText(this.heading, `Waterfall · ${view.position}`);
    this.toggle.setAttribute("aria-pressed", String(this.tabled()));
    this.tableBox.hidden = !this.tabled();
    this.box.hidden = this.tabled();
    if (this.picture && this.picture.header.position !== view.position) this.picture = this.marks = null;
    this.draw();
    this.schedule(READ_MS);
  }

  /** @param {HTMLSelectElement} select @param {Record<string, string>} options @param {string} value */
  options(select, options, value) {
    const made = JSON.stringify(options);
    if (select.dataset.made !== made) select.replaceChildren(...Object.entries(options).map(([key, text]) => el("option", { value: key, text })));
    select.dataset.made = made;
    select.value = value;
  }

  /** @param {number} ms */
  schedule(ms) {
    if (this.timer !== undefined) return;
    this.timer = setTimeout(async () => {
      // Another question, or the first: whatever waits is gone on with.
      this.pending = this.asked === "" ? (this.picture?.header.pending_sets ?? Infinity) : Infinity;
      await this.read();
      const left = this.picture?.header.pending_sets ?? 0;
      this.timer = undefined;
      if (this.asked !== this.question()) this.schedule(READ_MS);
      else if (left > 0 && left < this.pending) {
        // Sets without tiles are read some at a time, as long as they get fewer: the service's memory has an end.
        this.asked = "";
        this.schedule(GO_ON_MS);
      }
    }, ms);
  }

  /** What would be asked now; the newest set of the position is part of it. */
  question() {
    const { position, align, shown } = this.host.view();
    const ratio = devicePixelRatio;
    const area = this.area();
    const first = this.method === "pulse_echo" ? "first_echo" : "isw";
    const [from, to] = this.hours();
    const { from_wf_us, to_wf_us } = this.host.view();
    return JSON.stringify([
      position,
      {
        // Rows at both edges reach beyond them.
        from_h: from - 0.02 * (to - from),
        to_h: to + 0.02 * (to - from),
        from_s: from_wf_us === null ? null : from_wf_us / 1e6,
        to_s: to_wf_us === null ? null : to_wf_us / 1e6,
        align: align === "first" ? first : "trigger",
        as: shown,
        rows: Math.min(MOST_ROWS, Math.max(16, Math.round(area.width * ratio))),
        columns: Math.min(MOST_COLUMNS, Math.max(16, Math.round(area.height * ratio))),
      },
      this.newest,
    ]);
  }

  /** Something may be new. @param {string} newest what there is of the position */
  renew(newest) {
    this.newest = newest;
    if (this.trouble) this.asked = "";
    this.update();
  }

  async read() {
    const question = this.question();
    if (question === this.asked) return;
    const [position, query] = JSON.parse(question);
    try {
      const [picture, marks] = await Promise.all([readPicture(position, query), this.host.trend(position, TRACKS[this.method].map((track) => track.field), { from_h: query.from_h, to_h: query.to_h })]);
      if (position !== this.host.view().position) return;
      this.picture = picture;
      this.marks = marks;
      this.limit = greatestOf(picture);
      this.trouble = "";
    } catch (error) {
      this.trouble = /** @type {Error} */ (error).message;
      this.picture = null;
    }
    this.asked = question;
    this.draw();
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
    const empty = this.trouble || (picture && !picture.header.rows ? "No record in these hours" : "");
    setText(this.emptyText, picture || empty ? empty : "Reading");
    this.emptyText.hidden = Boolean(picture?.header.rows);
    this.image.hidden = this.over.hidden = this.axes.hidden = !picture?.header.rows;
    this.dataset.drawn = picture ? String(picture.header.rows) : "";
    if (!picture?.header.rows || !this.box.clientWidth) {
      if (picture?.header.rows) this.describe();
      if (picture?.header.rows && this.tabled()) this.fillTable();
      return;
    }
    const area = this.area();
    const ratio = devicePixelRatio;
    for (const canvas of [this.image, this.over]) {
      Object.assign(canvas.style, { left: `${area.left}px`, top: `${area.top}px`, width: `${area.width}px`, height: `${area.height}px` });
      canvas.width = Math.round(area.width * ratio);
      canvas.height = Math.round(area.height * ratio);
    }
    const [hours, seconds] = [this.hours(), this.seconds()];
    paint(/** @type {CanvasRenderingContext2D} */ (this.image.getContext("2d")), picture, hours, seconds, this.limit);
    this.axes.width = Math.round(this.box.clientWidth * ratio);
    this.axes.height = Math.round(this.box.clientHeight * ratio);
    const axes = /** @type {CanvasRenderingContext2D} */ (this.axes.getContext("2d"));
    axes.scale(ratio, ratio);
    const micros = /** @type {Span} */ (seconds.map((value) => value * 1e6));
    drawAxes(axes, area, hours, { span: micros, label: `Time from the ${this.anchorWord()} (µs)` }, this.thickness(seconds), this.host.timeline());
    const { hides } = this.host.view();
    const over = this.host.over(picture.header.position);
    paintOver(/** @type {CanvasRenderingContext2D} */ (this.over.getContext("2d")), {
      tracks: hides.includes("tracks") ? [] : this.tracks(),
      bad: hides.includes("bad") ? [] : this.badHours(),
      alarms: hides.includes("alarms") ? [] : over.alarms,
      gaps: hides.includes("gaps") ? [] : over.gaps,
      opened: over.opened,
    }, hours, seconds);
    this.showCursor();
    this.describe();
    if (this.tabled()) this.fillTable();
  }

  anchorWord() {
    const { align } = /** @type {Picture} */ (this.picture).header;
    return align === "isw" ? "ISW" : align === "first_echo" ? "first echo" : "trigger";
  }

  /** Thickness that a time is worth; from the first echo, what is more or less of it. @param {Span} seconds */
  thickness(seconds) {
    const { velocity_m_per_s: velocity, delay_s: delay, align } = /** @type {Picture} */ (this.picture).header;
    if (velocity === null) return null;
    const from = align === "trigger" ? delay : 0;
    return { span: /** @type {Span} */ (seconds.map((value) => (1e3 * velocity * (value - from)) / 2)), label: align === "trigger" ? "Thickness (mm)" : "Thickness beyond it (mm)" };
  }

  tracks() {
    const { columns } = this.marks;
    const { align } = /** @type {Picture} */ (this.picture).header;
    const [{ field: anchor }] = TRACKS[this.method];
    return TRACKS[this.method]
      .filter((track) => columns[track.field].some((/** @type {number | null} */ one) => one !== null))
      .map((track) => ({
        ...track,
        hours: columns.due_h,
        seconds: columns[track.field].map((/** @type {number | null} */ time, /** @type {number} */ k) => (time === null || (align !== "trigger" && columns[anchor][k] === null) ? null : time - (align === "trigger" ? 0 : columns[anchor][k]))),
      }));
  }

  badHours() {
    return this.marks.columns.due_h.filter((/** @type {number} */ _, /** @type {number} */ k) => this.marks.columns.quality[k] === "bad");
  }

  describe() {
    const { header } = /** @type {Picture} */ (this.picture);
    const unit = header.unit === "V" ? "V" : "of the row's greatest";
    const what = { volts: "sensor voltage", normalised: "each row over its greatest magnitude", difference: `difference from the mean of ${header.baseline_sets} sets of the baseline` }[/** @type {"volts"} */ (header.shown)];
    const each = header.row_sets === 1 ? "a set a row" : `${header.row_sets} sets a row`;
    const waits = header.pending_sets ? ` · ${header.pending_sets} sets are still being read` : "";
    const lost = header.unreadable_sets.length ? ` · cannot be read: set ${header.unreadable_sets.join(", ")}` : "";
    setText(this.subtitle, `${what}, ${each}, ${significant(1e6 * header.cell_s)} µs a cell: its sample furthest from zero${waits}${lost}`);
    this.box.setAttribute("aria-label", `Waterfall of position ${header.position}: ${what}, ${header.rows} rows from hour ${fixed(header.first_h[0], 1)} to ${fixed(header.last_h.at(-1), 1)}, time from the ${this.anchorWord()}. Arrow keys move a cursor that reads values, Page Up and Page Down zoom in time, Enter opens the set.`);
    const colours = palette(themeNow());
    const image = new ImageData(colours.length, 1);
    new Uint32Array(image.data.buffer).set(colours);
    /** @type {CanvasRenderingContext2D} */ (this.scale.getContext("2d")).putImageData(image, 0, 0);
    const ends = [-this.limit, this.limit].map((value) => `${significant(value)} ${unit}`);
    this.legend.replaceChildren(
      el("li", {}, ends[0], this.scale, ends[1]),
      el("li", {}, el("span", { class: "waterfall-none" }), "no record"),
      ...this.tracks().map((track) => el("li", {}, swatch(track.color, "line", track.dash), track.label)),
      el("li", {}, swatch("--alarm", "cross"), "bad set"),
    );
  }

  fillTable() {
    const picture = /** @type {Picture} */ (this.picture);
    const { header } = picture;
    const unit = header.unit === "V" ? " (V)" : "";
    const head = el("tr", {}, ...["Hour", "Sets", `Least${unit}`, `Greatest${unit}`, "Greatest at (µs)"].map((text) => el("th", { scope: "col", text })));
    const body = el("tbody");
    for (let row = header.rows - 1; row >= Math.max(0, header.rows - LONGEST_TABLE); row--) {
      let [least, greatest, at] = [Infinity, -Infinity, 0];
      for (let column = 0; column < header.columns; column++) {
        const cell = row * header.columns + column;
        if (picture.least[cell] < least) least = picture.least[cell];
        if (picture.greatest[cell] > greatest) [greatest, at] = [picture.greatest[cell], header.first_s + (column + 0.5) * header.cell_s];
      }
      const opens = this.button(fixed(header.first_h[row], 1), () => this.host.open(header.position, header.first_set[row]));
      opens.className = "link";
      opens.setAttribute("aria-label", `Open the set of hour ${fixed(header.first_h[row], 1)}`);
      const sets = header.first_set[row] === header.last_set[row] ? `${header.first_set[row]}` : `${header.first_set[row]} to ${header.last_set[row]}`;
      const texts = [sets, fixed(least, 3), fixed(greatest, 3), Number.isFinite(greatest) ? fixed(1e6 * at, 1) : "–"];
      body.append(el("tr", {}, el("td", {}, opens), ...texts.map((text) => el("td", { text }))));
    }
    const caption = el("caption", { text: `Waterfall: ${header.rows > LONGEST_TABLE ? `the newest ${LONGEST_TABLE} of ` : ""}${header.rows} rows, newest first` });
    this.tableBox.replaceChildren(el("table", {}, caption, el("thead", {}, head), body));
  }

  // ---- cursor and gestures ----------------------------------------------------------------------

  /** @param {{hour: number, seconds: number} | null} cursor */
  point(cursor) {
    this.cursor = cursor;
    this.showCursor();
  }

  showCursor() {
    const { cursor, picture } = this;
    const area = this.area();
    const [hours, seconds] = [this.hours(), this.seconds()];
    for (const line of this.cross) line.hidden = !cursor;
    if (!cursor || !picture) return setText(this.readout, "");
    const [down, across] = [this.cross[1], this.cross[0]];
    Object.assign(down.style, { left: `${area.left + ((cursor.hour - hours[0]) / (hours[1] - hours[0])) * area.width}px`, top: `${area.top}px`, height: `${area.height}px` });
    Object.assign(across.style, { top: `${area.top + ((cursor.seconds - seconds[0]) / (seconds[1] - seconds[0])) * area.height}px`, left: `${area.left}px`, width: `${area.width}px` });
    setText(this.readout, this.words(cursor));
  }

  /** @param {{hour: number, seconds: number}} cursor */
  words({ hour, seconds }) {
    const picture = /** @type {Picture} */ (this.picture);
    const { header } = picture;
    const row = rowAt(header, hour);
    const column = columnAt(header, seconds);
    const thick = this.thickness([seconds, seconds]);
    const place = [`hour ${fixed(row < 0 ? hour : header.first_h[row], 1)}`, this.host.timeline().text(hour), `${fixed(1e6 * seconds, 2)} µs from the ${this.anchorWord()}`, thick ? `${fixed(thick.span[0], 3)} mm` : ""];
    if (row < 0) return [...place, "no record"].filter(Boolean).join(" · ");
    const cell = row * header.columns + column;
    const unit = header.unit === "V" ? " V" : "";
    const values = column < 0 || Number.isNaN(picture.least[cell]) ? "no sample" : `${fixed(picture.least[cell], 3)} to ${fixed(picture.greatest[cell], 3)}${unit}`;
    const sets = header.first_set[row] === header.last_set[row] ? `set ${header.first_set[row]}` : `sets ${header.first_set[row]} to ${header.last_set[row]}`;
    return [...place, values, sets].filter(Boolean).join(" · ");
  }

  /** The set at the cursor; of several in a row the one that is due next to it. */
  openHere() {
    const { picture, cursor } = this;
    if (!picture || !cursor) return;
    const { header } = picture;
    const row = rowAt(header, cursor.hour);
    if (row < 0) return;
    const [first, last] = [header.first_set[row], header.last_set[row]];
    const part = (cursor.hour - header.first_h[row]) / (header.until_h[row] - header.first_h[row]);
    this.host.open(header.position, Math.min(last, first + Math.floor(part * (last - first + 1))));
  }

  /** @param {MouseEvent} event @returns {{hour: number, seconds: number} | null} null: beside the picture */
  at(event) {
    const box = this.over.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    if (!(x >= 0 && x < 1 && y >= 0 && y < 1)) return null;
    const [hours, seconds] = [this.hours(), this.seconds()];
    return { hour: hours[0] + x * (hours[1] - hours[0]), seconds: seconds[0] + y * (seconds[1] - seconds[0]) };
  }

  /** @param {Span | null} span @param {boolean} [gesture] */
  showHours(span, gesture = true) {
    this.host.go({ from_h: span?.[0] ?? null, to_h: span?.[1] ?? null }, { gesture });
  }

  /** @param {Span | null} span */
  showSeconds(span) {
    this.host.go({ from_wf_us: span ? span[0] * 1e6 : null, to_wf_us: span ? span[1] * 1e6 : null }, { gesture: true });
  }

  gestures() {
    let pointed = false;
    document.addEventListener("scroll", () => void (pointed = false), { passive: true });
    this.box.addEventListener("mousemove", (event) => {
      pointed = true;
      this.point(this.at(event));
    });
    this.box.addEventListener("mouseleave", () => this.point(null));
    this.box.addEventListener("click", (event) => {
      this.point(this.at(event));
      this.openHere();
    });
    this.box.addEventListener("wheel", (event) => {
      const place = this.at(event);
      if (!place || (!pointed && !event.ctrlKey)) return;
      event.preventDefault();
      const turned = Math.abs(event.deltaY) > Math.abs(event.deltaX) ? event.deltaY : event.deltaX;
      const factor = 1.25 ** ((turned * (event.deltaMode === 1 ? 16 : 1)) / 100);
      if (event.shiftKey) this.showSeconds(zoomed(this.seconds(), this.wholeSeconds(), factor, place.seconds));
      else this.showHours(zoomed(this.hours(), this.host.whole(), factor, place.hour));
    }, { passive: false });
    this.pinch();
    this.box.addEventListener("keydown", (event) => this.onKey(event));
  }

  /** One finger moves the picture, two zoom each axis by how far they part along it. */
  pinch() {
    /** @type {Map<number, {x: number, y: number}>} */
    const fingers = new Map();
    const place = (/** @type {PointerEvent} */ event) => ({ x: event.clientX, y: event.clientY });
    this.box.addEventListener("pointerdown", (event) => event.pointerType === "touch" && fingers.set(event.pointerId, place(event)));
    this.box.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = place(event);
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
      fingers.set(event.pointerId, now);
      const area = this.area();
      const [hours, seconds] = [this.hours(), this.seconds()];
      if (!other) {
        this.showHours(panned(hours, this.host.whole(), ((before.x - now.x) / area.width) * (hours[1] - hours[0])));
        return;
      }
      const factor = (/** @type {number} */ was, /** @type {number} */ is) => (Math.abs(is) < 30 || Math.abs(was) < 30 ? 1 : Math.abs(was) / Math.abs(is));
      const box = this.over.getBoundingClientRect();
      const [x, y] = [(other.x - box.left) / box.width, (other.y - box.top) / box.height];
      this.showHours(zoomed(hours, this.host.whole(), factor(before.x - other.x, now.x - other.x), hours[0] + x * (hours[1] - hours[0])));
      this.showSeconds(zoomed(seconds, this.wholeSeconds(), factor(before.y - other.y, now.y - other.y), seconds[0] + y * (seconds[1] - seconds[0])));
    });
    for (const name of ["pointerup", "pointercancel"]) this.box.addEventListener(name, (event) => fingers.delete(/** @type {PointerEvent} */ (event).pointerId));
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    if (!this.picture?.header.rows) return;
    const { header } = this.picture;
    const [hours, seconds] = [this.hours(), this.seconds()];
    const cursor = this.cursor ?? { hour: header.last_h.at(-1), seconds: (seconds[0] + seconds[1]) / 2 };
    if (onZoomKey(event, { span: () => hours, whole: () => this.host.whole(), show: (to) => this.showHours(to), centre: () => cursor.hour })) return;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key === "PageUp" || event.key === "PageDown") this.showSeconds(zoomed(seconds, this.wholeSeconds(), event.key === "PageUp" ? 1 / 1.5 : 1.5, cursor.seconds));
    else if (event.key === "Enter") this.openHere();
    else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      const by = (event.key === "ArrowUp" ? -1 : 1) * Math.max(header.cell_s, (seconds[1] - seconds[0]) / 200);
      this.moveTo({ ...cursor, seconds: Math.max(this.wholeSeconds()[0], Math.min(this.wholeSeconds()[1], cursor.seconds + by)) });
    } else if (["ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) {
      // Without a cursor the first step goes to the newest row.
      const here = this.cursor ? header.first_h.findLastIndex((/** @type {number} */ first) => first <= cursor.hour) : header.rows;
      const row = { ArrowLeft: here - 1, ArrowRight: here + 1, Home: 0, End: header.rows - 1 }[/** @type {"Home"} */ (event.key)];
      this.moveTo({ ...cursor, hour: header.first_h[Math.max(0, Math.min(header.rows - 1, row))] });
    } else return;
    event.preventDefault();
  }

  /** Bring the cursor where it is seen. @param {{hour: number, seconds: number}} cursor */
  moveTo(cursor) {
    const [from, to] = this.hours();
    const half = (to - from) / 2;
    if (cursor.hour < from || cursor.hour > to) this.showHours(within([cursor.hour - half, cursor.hour + half], this.host.whole()));
    this.point(cursor);
  }

  /** What is drawn, for tests and for the curious; copies. */
  snapshot() {
    if (!this.host?.info() || !this.method) return { ready: false };
    const { header } = this.picture ?? { header: null };
    return { header: structuredClone(header), limit: this.limit, hours: this.hours(), seconds: this.seconds(), tracks: this.picture ? structuredClone(this.tracks()) : [], cursor: this.cursor, ready: Boolean(this.picture) && this.asked === this.question() };
  }
}
