// Show all waveforms of the chosen position as one image: an inspector's B-scan. Hours are those of
// the charts; overlays can be switched; each point opens its set.

import { swatch } from "../charts/legend.js";
import { button, el, setText } from "../dom.js";
import { significant } from "../format.js";
import { drawAxes } from "./axes.js";
import { palette, themeNow } from "./colors.js";
import { attach } from "./gestures.js";
import { badHoursOf, tracksOf } from "./marks.js";
import { paint, paintOver } from "./paint.js";
import { setAt } from "./image.js";
import { ImageLoader } from "./image-loader.js";
import { tableOf } from "./table.js";
import { anchorOf, labelOf, readoutOf, subtitleOf, thicknessOf } from "./labels.js";

/**
 * @typedef {import("./image.js").WaterfallImage} WaterfallImage
 * @typedef {import("./labels.js").Span} Span
 * @typedef {import("./labels.js").Cursor} Cursor
 */
/**
 * @typedef {object} Host
 * @property {() => any} info null: the chosen position is not known yet
 * @property {() => import("../view.js").View} view
 * @property {(part: Partial<import("../view.js").View>, how?: {gesture?: boolean}) => void} go
 * @property {() => Span} full hours of the test
 * @property {() => import("../timeline.js").Timeline} timeline
 * @property {(position: string, set: number) => void} open
 * @property {(position: string) => Omit<import("./paint.js").Over, "tracks" | "bad">} over
 * @property {(position: string, fields: string[], range: Record<string, number>) => Promise<any>} trend
 * @property {() => boolean} hasBaseline whether the chosen position has one
 */

const MAX_ROWS = 512;
const MAX_COLUMNS = 1024;
const GUTTER = { left: 58, right: 12, rightOfThickness: 54, top: 6, bottom: 40, bottomOfDates: 54 };
const SHOWN = { volts: "Volts", normalised: "Normalized", difference: "Difference from the baseline" };
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
  if (select.dataset.made !== made)
    select.replaceChildren(...Object.entries(options).map(([key, text]) => el("option", { value: key, text })));
  select.dataset.made = made;
  select.value = value;
}

/** @param {string[]} list @param {string} one added where it is missing, else removed */
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
    this.loader = new ImageLoader(
      () => this.wanted(),
      (position, fields, range) => this.host.trend(position, fields, range),
      () => this.draw(),
    );
    /** @type {import("./axes.js").Box | null} */
    this.lastArea = null;
    /** Position of the pointer or of the keyboard cursor. @type {Cursor | null} */
    this.cursor = null;
    this.heading = el("h2", { id: "waterfall-title", text: "Waterfall" });
    this.subtitle = el("p");
    this.readout = el("p", { class: "readout", "aria-live": "polite" });
    this.align = choice("Time counts from", (align) =>
      this.host.go({ align: /** @type {any} */ (align), from_wf_us: null, to_wf_us: null }),
    );
    this.shown = choice("Values of the waterfall", (shown) => this.host.go({ shown: /** @type {any} */ (shown) }));
    this.resetButton = button("Full waveform", () => this.host.go({ from_wf_us: null, to_wf_us: null }));
    this.toggle = button("Table", () => this.host.go({ tables: toggled(this.host.view().tables, "waterfall") }), {
      "aria-label": "Table of: Waterfall",
    });
    this.overlayButtons = Object.entries(OVER).map(([key, text]) =>
      button(text, () => this.host.go({ hides: toggled(this.host.view().hides, key) }), { "data-over": key }),
    );
    this.box = el("div", { class: "plot waterfall", tabindex: "0", role: "img", "aria-label": "Waterfall" });
    this.imageCanvas = canvas("image");
    this.over = canvas("over");
    this.axes = canvas("axes");
    this.cross = [
      el("span", { class: "waterfall-cross across", hidden: true }),
      el("span", { class: "waterfall-cross down", hidden: true }),
    ];
    this.emptyText = el("p", { class: "empty", text: "Loading" });
    this.box.append(this.axes, this.imageCanvas, this.over, ...this.cross, this.emptyText);
    this.tableBox = el("div", {
      class: "table-wrap",
      tabindex: "0",
      role: "region",
      "aria-label": "Waterfall, table",
      hidden: true,
    });
    this.scale = canvas("scale", { width: "255", height: "1" });
    this.legend = el("ul", { class: "legend" });
    attach(this.box, {
      hours: {
        span: () => this.hours(),
        full: () => this.host.full(),
        show: (span) => this.host.go({ from_h: span?.[0] ?? null, to_h: span?.[1] ?? null }, { gesture: true }),
      },
      seconds: {
        span: () => this.seconds(),
        full: () => this.fullSeconds(),
        show: (span) =>
          this.host.go(
            { from_wf_us: span ? span[0] * 1e6 : null, to_wf_us: span ? span[1] * 1e6 : null },
            { gesture: true },
          ),
      },
      bounds: () => this.over.getBoundingClientRect(),
      header: () => this.image?.header,
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
    const actions = el(
      "div",
      { class: "card-actions wrap" },
      this.align,
      this.shown,
      ...this.overlayButtons,
      this.resetButton,
      this.toggle,
    );
    this.append(
      el("div", { class: "card-head" }, el("div", {}, this.heading, this.subtitle)),
      actions,
      this.readout,
      this.box,
      this.tableBox,
      this.legend,
    );
  }

  get image() {
    return this.loader.image;
  }

  showsTable() {
    return this.host.view().tables.includes("waterfall");
  }

  /** The method of the chosen position; undefined: it is not known yet. @returns {string | undefined} */
  get method() {
    return this.host
      ?.info()
      ?.positions.find((/** @type {any} */ positionInfo) => positionInfo.position === this.host.view().position)
      ?.method;
  }

  /** @returns {Span} */
  hours() {
    const { from_h, to_h } = this.host.view();
    return from_h === null || to_h === null ? this.host.full() : [from_h, to_h];
  }

  /** Return the time span of the waveforms. @returns {Span} seconds */
  fullSeconds() {
    return this.image?.header.whole_s ?? [0, 1];
  }

  /** @returns {Span} */
  seconds() {
    const { from_wf_us, to_wf_us } = this.host.view();
    return from_wf_us === null || to_wf_us === null ? this.fullSeconds() : [from_wf_us / 1e6, to_wf_us / 1e6];
  }

  /** Show the view; called after each change of it and of the data. */
  update() {
    const { method } = this;
    if (!method) return;
    const view = this.host.view();
    offer(
      this.align,
      { trigger: "From the trigger", first: `From the ${method === "pulse_echo" ? "first echo" : "ISW"}` },
      view.align,
    );
    offer(this.shown, SHOWN, view.shown);
    for (const one of this.overlayButtons)
      one.setAttribute("aria-pressed", String(!view.hides.includes(one.dataset.over ?? "")));
    this.resetButton.disabled = view.from_wf_us === null;
    setText(this.heading, `Waterfall · ${view.position}`);
    this.toggle.setAttribute("aria-pressed", String(this.showsTable()));
    this.tableBox.hidden = !this.showsTable();
    this.box.hidden = this.showsTable();
    if (this.image && this.image.header.position !== view.position)
      Object.assign(this.loader, { image: null, answeredQuestion: "" });
    this.draw();
    this.loader.schedule();
  }

  /** Check for newer data. @param {string} newest newest data of the position */
  renew(newest) {
    this.loader.renew(newest);
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
      // Rows at both edges extend past them.
      from_h: from - 0.02 * (to - from),
      to_h: to + 0.02 * (to - from),
      from_s: from_wf_us === null ? null : from_wf_us / 1e6,
      to_s: to_wf_us === null ? null : to_wf_us / 1e6,
      align: align === "first" ? first : "trigger",
      as: shown,
      rows: Math.min(MAX_ROWS, Math.max(16, Math.round(area.width * devicePixelRatio))),
      columns: Math.min(MAX_COLUMNS, Math.max(16, Math.round(area.height * devicePixelRatio))),
    };
    const missingReason =
      shown === "difference" && !this.host.hasBaseline() ? `Position ${position} has no baseline yet` : "";
    return { position, method, query, missingReason };
  }

  /** Return the area of the image in the box, in CSS pixels. */
  area() {
    // While a table is shown the box has no size; the image keeps its last area.
    if (!this.box.clientWidth && this.lastArea) return this.lastArea;
    const right = this.method === "pulse_echo" ? GUTTER.rightOfThickness : GUTTER.right;
    const bottom = this.host.timeline().axis === "hours" ? GUTTER.bottom : GUTTER.bottomOfDates;
    return (this.lastArea = {
      left: GUTTER.left,
      top: GUTTER.top,
      width: Math.max(1, this.box.clientWidth - GUTTER.left - right),
      height: Math.max(1, this.box.clientHeight - GUTTER.top - bottom),
    });
  }

  draw() {
    const { image } = this;
    const { trouble } = this.loader;
    const drawn = Boolean(image?.header.rows);
    setText(this.emptyText, trouble || (image ? "No waveform in these hours" : "Loading"));
    this.emptyText.hidden = drawn;
    this.imageCanvas.hidden = this.over.hidden = this.axes.hidden = !drawn;
    this.dataset.drawn = image ? String(image.header.rows) : "";
    if (!drawn || !image) return;
    if (this.box.clientWidth) this.drawImage(image);
    this.describe(image.header);
    if (this.showsTable())
      this.tableBox.replaceChildren(tableOf(image, (set) => this.host.open(image.header.position, set)));
  }

  /** @param {WaterfallImage} image */
  drawImage(image) {
    const area = this.area();
    const ratio = devicePixelRatio;
    for (const canvas of [this.imageCanvas, this.over]) {
      Object.assign(canvas.style, {
        left: `${area.left}px`,
        top: `${area.top}px`,
        width: `${area.width}px`,
        height: `${area.height}px`,
      });
      canvas.width = Math.round(area.width * ratio);
      canvas.height = Math.round(area.height * ratio);
    }
    const { header } = image;
    const [hours, seconds] = [this.hours(), this.seconds()];
    paint(contextOf(this.imageCanvas), image, hours, seconds, this.loader.limit);
    this.axes.width = Math.round(this.box.clientWidth * ratio);
    this.axes.height = Math.round(this.box.clientHeight * ratio);
    const axes = contextOf(this.axes);
    axes.scale(ratio, ratio);
    const micros = /** @type {Span} */ (seconds.map((value) => value * 1e6));
    drawAxes(
      axes,
      area,
      hours,
      { span: micros, label: `Time from the ${anchorOf(header)} (µs)` },
      thicknessOf(header, seconds),
      this.host.timeline(),
    );
    const { hides } = this.host.view();
    const over = this.host.over(header.position);
    const marks = {
      tracks: hides.includes("tracks") ? [] : this.tracks(),
      bad: hides.includes("bad") ? [] : badHoursOf(this.loader.columns),
      alarms: hides.includes("alarms") ? [] : over.alarms,
      gaps: hides.includes("gaps") ? [] : over.gaps,
      opened: over.opened,
    };
    paintOver(contextOf(this.over), marks, hours, seconds);
    this.showCursor();
  }

  tracks() {
    return this.image ? tracksOf(this.image.header, this.loader.columns) : [];
  }

  /** @param {any} header */
  describe(header) {
    setText(this.subtitle, subtitleOf(header));
    this.box.setAttribute("aria-label", labelOf(header));
    const colors = palette(themeNow());
    const imageCanvas = new ImageData(colors.length, 1);
    new Uint32Array(imageCanvas.data.buffer).set(colors);
    contextOf(this.scale).putImageData(imageCanvas, 0, 0);
    const { limit } = this.loader;
    const ends = [-limit, limit].map(
      (value) => `${significant(value)} ${header.unit === "V" ? "V" : "of the row maximum"}`,
    );
    this.legend.replaceChildren(
      el("li", {}, ends[0], this.scale, ends[1]),
      el("li", {}, el("span", { class: "waterfall-none" }), "no waveform"),
      ...this.tracks().map((track) => el("li", {}, swatch(track.color, "line", track.dash), track.label)),
      el("li", {}, swatch("--alarm", "cross"), "bad set"),
    );
  }

  showCursor() {
    const { cursor, image } = this;
    const area = this.area();
    const [hours, seconds] = [this.hours(), this.seconds()];
    for (const line of this.cross) line.hidden = !cursor;
    if (!cursor || !image) return setText(this.readout, "");
    const [across, down] = this.cross;
    Object.assign(down.style, {
      left: `${area.left + ((cursor.hour - hours[0]) / (hours[1] - hours[0])) * area.width}px`,
      top: `${area.top}px`,
      height: `${area.height}px`,
    });
    Object.assign(across.style, {
      top: `${area.top + ((cursor.seconds - seconds[0]) / (seconds[1] - seconds[0])) * area.height}px`,
      left: `${area.left}px`,
      width: `${area.width}px`,
    });
    setText(this.readout, readoutOf(image, cursor, this.host.timeline()));
  }

  /** Open the set at the cursor. */
  openHere() {
    const { image, cursor } = this;
    const set = image && cursor ? setAt(image.header, cursor.hour) : null;
    if (image && set !== null) this.host.open(image.header.position, set);
  }

  /** Return copies of what is drawn, for tests and the console. */
  snapshot() {
    if (!this.method) return { ready: false };
    return {
      header: structuredClone(this.image?.header ?? null),
      limit: this.loader.limit,
      hours: this.hours(),
      seconds: this.seconds(),
      tracks: structuredClone(this.tracks()),
      cursor: this.cursor,
      ready: this.loader.settled,
    };
  }
}
