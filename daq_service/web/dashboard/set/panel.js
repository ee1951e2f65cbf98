// Show one set in detail: its waveforms and all its data.

import { get } from "../api.js";
import { onZoomKey } from "../charts/gestures.js";
import { swatch } from "../charts/legend.js";
import { button, el, setText } from "../dom.js";
import { exportMenu, setOffer } from "../export.js";
import { duration, fixed, hour, scheduledIndex, setName, time } from "../format.js";
import { PRIORITIES, chip } from "../icons.js";
import { marksOf } from "../pulses.js";
import { readSetData } from "./data.js";
import { climate, distance, features, provenance, shots } from "./facts.js";
import { plotWaveforms } from "./plot.js";
import { mean, readWaveforms } from "./waveforms.js";

/** @typedef {import("./data.js").SetData} SetData @typedef {import("./waveforms.js").Waveform} Waveform */

const TABLE_ROWS = 400;
const TWIN_RETRY_MS = 1000;
const QUALITY = /** @type {Record<string, import("../icons.js").Look>} */ ({
  good: { label: "Good", icon: "check", tone: "good" },
  suspect: { label: "Suspect", icon: "triangle", tone: "warn" },
  bad: { label: "Bad", icon: "stop", tone: "alarm" },
});

/**
 * @typedef {object} Host
 * @property {() => any} info
 * @property {(position: string) => Record<string, string>} units of the position's columns
 * @property {(position: string) => number | null} ghost a set of the baseline whose mean is also drawn
 * @property {(position: string) => number} last newest set
 * @property {() => import("../view.js").View} view
 * @property {(part: Partial<import("../view.js").View>, how?: {step?: boolean, gesture?: boolean}) => void} go
 */

export class SolimonSet extends HTMLElement {
  constructor() {
    super();
    /** @type {Host} */
    this.host = /** @type {any} */ (null);
    /** @type {SetData | null} */
    this.data = null;
    /** @type {Float64Array | null} */
    this.ghost = null;
    this.ghostOf = "";
    /** @type {any} */
    this.plotted = null;
    /** Simulated waveform of the set. @type {any} */
    this.twin = null;
    this.requested = "";
    /** The view drawn last, without set and span. */
    this.drawnView = "";
    /** @type {HTMLElement | null} element that had the focus before */
    this.returnFocus = null;
    this.heading = el("h2", { id: "set-title", tabindex: "-1" });
    this.subtitle = el("p");
    this.chips = el("span", { class: "chips" });
    this.previous = button("‹ Previous set", () => this.step(-1));
    this.next = button("Next set ›", () => this.step(1));
    this.resetButton = button("Full waveform", () => this.host.go({ from_us: null, to_us: null }));
    this.toggle = button("Table", () =>
      this.host.go({
        tables: this.showsTable()
          ? this.host.view().tables.filter((id) => id !== "set")
          : [...this.host.view().tables, "set"],
      }),
    );
    this.toggle.setAttribute("aria-label", "Table of: waveforms of the set");
    this.twinButton = button("Twin", () => this.toggleTwin(), {
      "aria-pressed": "false",
      "aria-label": "Simulated waveform of the twin",
    });
    this.twinState = el("p", { role: "status" });
    this.close = button("Close", () => this.leave());
    this.box = el("div", { class: "plot tall", role: "img", tabindex: "0", "aria-label": "Waveforms of the set" });
    this.emptyText = el("p", { class: "empty" });
    this.readout = el("p", { class: "plot-readout" });
    this.box.append(this.emptyText, this.readout);
    this.tableBox = el("div", {
      class: "table-wrap",
      tabindex: "0",
      role: "region",
      "aria-label": "Waveforms of the set, table",
      hidden: true,
    });
    this.legend = el("ul", { class: "legend" });
    this.facts = el("div", { class: "facts-grid" });
    this.box.addEventListener("keydown", (event) => this.onPlotKey(event));
    new ResizeObserver(() => this.resize()).observe(this.box);
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "set-title");
    this.append(
      el(
        "div",
        { class: "card-head" },
        el("div", {}, this.heading, this.subtitle, this.twinState, this.chips),
        el(
          "div",
          { class: "card-actions" },
          this.previous,
          this.next,
          this.resetButton,
          this.twinButton,
          this.toggle,
          exportMenu("waveforms of the set", () => this.offer()),
          this.close,
        ),
      ),
      this.box,
      this.tableBox,
      this.legend,
      this.facts,
    );
    document.addEventListener("keydown", (event) => this.onKey(event));
  }

  showsTable() {
    return this.host.view().tables.includes("set");
  }

  /** Show the view; called after each change of it. */
  update() {
    const { position, set } = this.host.view();
    if (set === null) {
      if (this.hidden) return;
      this.hidden = true;
      this.requested = "";
      this.data = null;
      this.clearPlot();
      this.returnFocus?.focus();
      return;
    }
    if (this.hidden) {
      this.hidden = false;
      this.returnFocus = /** @type {HTMLElement | null} */ (document.activeElement);
      this.heading.focus();
      this.scrollIntoView({ block: "start" });
    }
    this.resetButton.disabled = this.host.view().from_us === null;
    const { from_us, to_us, ...rest } = this.host.view();
    // Units and the baseline's set may arrive after the set that an address opens.
    const drawnView = JSON.stringify([
      rest.shot,
      rest.tables,
      rest.theme,
      Object.keys(this.host.units(position)),
      this.host.ghost(position),
    ]);
    this.updateNeighbors();
    if (this.requested === `${position} ${set}` && this.data && drawnView === this.drawnView)
      return this.plotted?.plot.setScale("x", this.plotted.plot.scales.x);
    this.drawnView = drawnView;
    if (this.requested !== `${position} ${set}`) void this.read();
    else if (this.data) {
      this.render();
      void this.readGhost(position).then(() => this.draw());
    }
  }

  /** Read the set again, e.g. after its assessment. */
  async read() {
    const { position, set } = this.host.view();
    if (set === null) return;
    const requested = (this.requested = `${position} ${set}`);
    const positionInfo = this.host.info().positions.find((/** @type {any} */ one) => one.position === position);
    setText(this.heading, `Position ${position} · ${setName(set)}`);
    setText(this.subtitle, positionInfo.label);
    this.updateNeighbors();
    try {
      const data = await readSetData(position, positionInfo.method, set);
      if (this.requested !== requested) return;
      this.data = data;
      this.twin = null;
      this.render();
      void this.readTwin();
      await this.readGhost(position);
      if (this.requested === requested) this.draw();
    } catch (error) {
      // The next update reads it again; until then show the error, and nothing old below a new heading.
      if (this.requested !== requested) return;
      this.requested = "";
      this.data = null;
      this.clearPlot();
      this.facts.replaceChildren();
      setText(this.emptyText, `This set cannot be read: ${/** @type {Error} */ (error).message}`);
      this.emptyText.hidden = false;
    }
  }

  /** @param {string} position */
  async readGhost(position) {
    const index = this.host.ghost(position);
    const ghostKey = index === null ? "" : `${position} ${index}`;
    if (ghostKey === this.ghostOf) return;
    this.ghost = null;
    this.ghostOf = ghostKey;
    if (index === null) return;
    try {
      const { waveforms } = await readWaveforms(position, index);
      this.ghost = mean(waveforms);
    } catch (error) {
      console.info(`no baseline waveform next to the set: ${/** @type {Error} */ (error).message}`);
    }
  }

  toggleTwin() {
    this.twinButton.setAttribute("aria-pressed", String(this.twinButton.getAttribute("aria-pressed") !== "true"));
    this.twin = null;
    this.draw();
    void this.readTwin();
  }

  /** Draw the simulated waveform if it is wanted, as soon as it is there. */
  async readTwin() {
    const { position, set } = this.host.view();
    const { requested } = this;
    const isWanted = () => this.twinButton.getAttribute("aria-pressed") === "true" && this.requested === requested;
    setText(this.twinState, "");
    try {
      while (isWanted() && this.twin === null) {
        const answer = await get(`/sets/${position}/${set}/twin`);
        if (!isWanted()) return;
        setText(this.twinState, answer.voltage_v ? "" : "The twin simulates this wall");
        if (answer.voltage_v === null) await new Promise((done) => setTimeout(done, TWIN_RETRY_MS));
        else this.twin = answer;
        this.draw();
      }
    } catch (error) {
      if (isWanted()) setText(this.twinState, /** @type {Error} */ (error).message);
    }
  }

  /** Enable or disable the buttons of the neighboring sets. */
  updateNeighbors() {
    const { position, set } = this.host.view();
    this.previous.disabled = set === 0;
    this.next.disabled = set !== null && scheduledIndex(set) >= this.host.last(position);
  }

  /** @param {number} by */
  step(by) {
    const { position, set } = this.host.view();
    if (set === null) return;
    // A confirmation set lies between two scheduled ones.
    const planned = scheduledIndex(set);
    const next = Math.max(0, Math.min(this.host.last(position), planned === set || by > 0 ? planned + by : planned));
    if (next !== set) this.host.go({ set: next, shot: null }, { step: true });
  }

  leave() {
    this.host.go({ set: null, shot: null, from_us: null, to_us: null });
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    if (this.hidden || event.defaultPrevented || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey)
      return;
    const target = /** @type {HTMLElement} */ (event.target);
    if (
      target.closest("dialog, input, textarea, select, [role=radiogroup], .plot, .table-wrap") &&
      event.key !== "Escape"
    )
      return;
    if (document.querySelector("dialog[open]")) return;
    if (event.key === "Escape") this.leave();
    else if (event.key === "ArrowLeft") this.step(-1);
    else if (event.key === "ArrowRight") this.step(1);
    else return;
    event.preventDefault();
  }

  /** @param {KeyboardEvent} event */
  onPlotKey(event) {
    if (!this.plotted) return;
    const { plot, zoomable } = this.plotted;
    if (onZoomKey(event, zoomable)) return;
    const steps = /** @type {Record<string, number>} */ ({ ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20 });
    const step = steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const at = plot.cursor.left < 0 ? plot.over.clientWidth / 2 : plot.cursor.left;
    plot.setCursor(
      { left: Math.max(0, Math.min(plot.over.clientWidth, at + 3 * step)), top: plot.over.clientHeight / 2 },
      true,
    );
  }

  render() {
    const data = /** @type {SetData} */ (this.data);
    const { set, assessment, feature } = data;
    const info = this.host.info();
    const view = this.host.view();
    const units = this.host.units(view.position);
    const positionInfo = info.positions.find((/** @type {any} */ one) => one.position === view.position);
    this.updateNeighbors();
    this.twinButton.hidden = positionInfo.method === "pulse_echo";
    setText(
      this.heading,
      `Position ${view.position} · ${setName(view.set ?? 0)}${set ? ` · hour ${hour(set.due_h)}` : ""}`,
    );
    setText(
      this.subtitle,
      set
        ? `${positionInfo.label} · ${time(set.due_utc)} · ${duration(3600 * set.age_h)} old on the test clock`
        : positionInfo.label,
    );
    const chips = [];
    if (set && set.state !== "done")
      chips.push(chip({ label: set.reason ? `${set.state}: ${set.reason}` : set.state, icon: "dash", tone: "warn" }));
    if (feature) chips.push(chip({ ...QUALITY[feature.quality], label: `Quality ${feature.quality}` }));
    if (assessment?.outlier) chips.push(chip({ ...PRIORITIES.high, label: "Outlier" }));
    if (assessment?.in_baseline) chips.push(chip({ label: "Baseline", icon: "flag", tone: "info" }));
    this.chips.replaceChildren(...chips);
    const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.shot;
    const parts = [
      features(data, units),
      positionInfo.method === "solitary_wave" ? distance(data, info.limits) : null,
      shots(data, units, view.shot, (shot) => this.host.go({ shot }, { step: true })),
      climate(data),
      provenance(data, info),
    ];
    this.facts.replaceChildren(...parts.filter((one) => one !== null));
    if (focused) /** @type {HTMLElement | null} */ (this.facts.querySelector(`[data-shot="${focused}"]`))?.focus();
    this.dataset.set = `${view.position} ${view.set}`;
    this.dataset.waveforms = String(data.waveforms?.waveforms.length ?? 0);
    this.draw();
  }

  /** @returns {import("./plot.js").Overlay | null} null: nothing to draw */
  overlay() {
    const stored = this.data?.waveforms;
    if (!stored?.waveforms.length) return null;
    const { feature, shots: all } = /** @type {SetData} */ (this.data);
    const [first] = stored.waveforms;
    const same = stored.waveforms.filter((one) => one.volts.length === first.volts.length);
    const valid = new Set(all.filter((shot) => shot.valid).map((shot) => shot.sequence));
    const { shot } = this.host.view();
    /** @type {import("./plot.js").Trace[]} */
    const traces = same.map((one) => ({
      label: `shot ${one.header.shot_index}${valid.has(one.header.sequence) ? "" : ", not valid"}`,
      volts: one.volts,
      color: valid.has(one.header.sequence) ? "--data" : "--alarm",
      width: 1,
      faint: same.length > 1,
      dash: valid.has(one.header.sequence) ? undefined : [3, 3],
    }));
    if (this.ghost?.length === first.volts.length)
      traces.unshift({
        label: `baseline: mean of set ${this.ghostOf.split(" ")[1]}, the most typical`,
        volts: this.ghost,
        color: "--ghost",
        width: 2,
        dash: [6, 4],
      });
    const averaged = same.length > 1 ? mean(same.filter((one) => valid.has(one.header.sequence))) : null;
    if (averaged) traces.push({ label: "mean of the valid shots", volts: averaged, color: "--ink", width: 2 });
    if (this.twin?.voltage_v.length === first.volts.length) {
      const { curve, thickness_m, due_h, quality } = this.twin.wall;
      traces.splice(-1, 0, {
        label:
          `simulated: ${curve}; wall ${fixed(1e3 * thickness_m, 2)} mm (hour ${hour(due_h)}, ${quality}), ` +
          "incident wave as measured",
        volts: Float64Array.from(this.twin.voltage_v),
        color: "--third",
        width: 2,
        dash: [6, 3],
      });
    }
    const chosen = shot === null ? undefined : same.find((one) => one.header.shot_index === shot);
    if (chosen)
      traces.push({
        label: `shot ${chosen.header.shot_index}, chosen`,
        volts: chosen.volts,
        color: "--limit",
        width: 2,
      });
    const marks =
      feature === null
        ? []
        : stored.header.method === "pulse_echo"
          ? this.echoMarks(feature.travel_time_s, first)
          : marksOf(feature);
    return { micros: first.micros, traces, marks, windows_s: stored.header.windows_s };
  }

  /** @param {number | null} time_s @param {Waveform} waveform */
  echoMarks(time_s, waveform) {
    if (time_s === null) return [];
    const { sample_rate_hz, pretrigger_samples } = waveform.header;
    const height_v = waveform.volts[Math.round(time_s * sample_rate_hz) + pretrigger_samples];
    return [{ name: "first echo", time_s, height_v: height_v ?? 0 }];
  }

  /** @returns {import("../export.js").Offer | null} */
  offer() {
    const { position, set } = this.host.view();
    const file = this.data?.waveforms && this.data.set.file;
    return file && set !== null ? setOffer(position, set, file) : null;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.box;
    if (this.plotted && width && height) this.plotted.plot.setSize({ width, height });
    else if (this.data && !this.plotted) this.draw();
  }

  clearPlot() {
    this.plotted?.detach();
    this.plotted?.plot.destroy();
    this.plotted = null;
  }

  /** Draw again, e.g. in the colors of another theme. */
  draw() {
    this.clearPlot();
    const overlay = this.overlay();
    setText(this.emptyText, overlay ? "" : this.data ? this.data.missingReason : "Loading");
    this.emptyText.hidden = overlay !== null;
    const showsTable = this.showsTable();
    this.tableBox.hidden = !showsTable;
    this.box.hidden = showsTable;
    this.toggle.setAttribute("aria-pressed", String(showsTable));
    this.legend.replaceChildren();
    if (!overlay) return this.tableBox.replaceChildren();
    const { waveforms: stored } = /** @type {SetData} */ (this.data);
    if (showsTable) this.fillTable(overlay);
    for (const trace of overlay.traces.filter((one) => !/^shot \d+$/.test(one.label)))
      this.legend.append(el("li", {}, swatch(trace.color, "line", trace.dash), trace.label));
    if (stored && stored.waveforms.length > 1)
      this.legend.prepend(el("li", {}, swatch("--data", "line"), `${stored.waveforms.length} shots`));
    if (stored?.header.n_damaged)
      this.legend.append(el("li", { text: `${stored.header.n_damaged} corrupt waveforms are left out` }));
    const marks = overlay.marks.map(
      (mark) => `${mark.name} ${fixed(mark.time_s * 1e6, 1)} µs, ${fixed(mark.height_v, 3)} V`,
    );
    this.box.setAttribute(
      "aria-label",
      `Waveforms of ${this.heading.textContent}: ${overlay.traces.length} curves; ${marks.join("; ")}`,
    );
    if (!this.box.clientWidth || !this.box.clientHeight) return;
    const host = {
      span: () => {
        const { from_us, to_us } = this.host.view();
        return from_us === null || to_us === null ? null : /** @type {[number, number]} */ ([from_us, to_us]);
      },
      show: (/** @type {[number, number] | null} */ span) =>
        this.host.go({ from_us: span?.[0] ?? null, to_us: span?.[1] ?? null }, { gesture: true }),
    };
    this.plotted = plotWaveforms(this.box, overlay, host, (index) =>
      setText(
        this.readout,
        index < 0
          ? ""
          : `${overlay.micros[index].toFixed(2)} µs · ` +
              `${overlay.traces[overlay.traces.length - 1].volts[index].toFixed(4)} V`,
      ),
    );
  }

  /** @param {import("./plot.js").Overlay} overlay */
  fillTable({ micros, traces }) {
    const step = Math.max(1, Math.ceil(micros.length / TABLE_ROWS));
    const body = el("tbody");
    for (let k = 0; k < micros.length; k += step)
      body.append(
        el(
          "tr",
          {},
          el("td", { text: micros[k].toFixed(2) }),
          ...traces.map((trace) => el("td", { text: trace.volts[k].toFixed(4) })),
        ),
      );
    const head = el(
      "tr",
      {},
      el("th", { scope: "col", text: "Time from the trigger (µs)" }),
      ...traces.map((trace) => el("th", { scope: "col", text: `${trace.label} (V)` })),
    );
    this.tableBox.replaceChildren(
      el(
        "table",
        {},
        el("caption", { text: `Every ${step}th of ${micros.length} samples; all of them are in the API` }),
        el("thead", {}, head),
        body,
      ),
    );
  }

  /** Return copies of what is drawn, for tests and the console. */
  snapshot() {
    const overlay = this.overlay();
    return (
      overlay && {
        labels: overlay.traces.map((trace) => trace.label),
        volts: overlay.traces.map((trace) => [...trace.volts]),
        marks: overlay.marks,
        windows_s: overlay.windows_s,
        drawn: Boolean(this.plotted),
        span: this.plotted ? this.plotted.zoomable.span() : null,
      }
    );
  }
}
