// Show the newest waveform of a position, live from the recorder.

import uPlot from "./vendor/uplot/uPlot.esm.js";
import { axisLook } from "./charts/plot.js";
import { color, el, setText } from "./dom.js";
import { NONE, fixed, hour, quantity, setKey, setName } from "./format.js";
import { PULSES, drawPulses, marksOf } from "./pulses.js";

/** @typedef {import("./streams.js").Waveform} Waveform */

export class SolimonWaveform extends HTMLElement {
  constructor() {
    super();
    /** @type {Waveform | null} */
    this.waveform = null;
    /** @type {any} */
    this.plot = null;
    this.received = 0;
    this.changes = 0;
    this.label = "";
    this.position = "";
    this.live = true;
    this.heading = el("h2", { text: "Waveform", id: "waveform-title" });
    this.subtitle = el("p", { text: "The newest waveform of the selected position" });
    this.toggle = el("button", { class: "button ghost small", type: "button", "aria-pressed": "false", text: "Table" });
    this.toggle.setAttribute("aria-label", "Table of: Waveform");
    this.readouts = el("dl", { class: "readouts" });
    this.box = el("div", { class: "plot", role: "img", tabindex: "0", "aria-label": "Waiting for the first waveform" });
    this.emptyText = el("p", { class: "empty", text: "Waiting for the first waveform" });
    this.readout = el("p", { class: "plot-readout" });
    this.box.append(this.emptyText, this.readout);
    this.tableBox = el("div", {
      class: "table-wrap",
      tabindex: "0",
      role: "region",
      "aria-label": "Waveform, table",
      hidden: true,
    });
    this.toggle.addEventListener("click", () => {
      const shown = this.tableBox.hidden;
      this.tableBox.hidden = !shown;
      this.box.hidden = shown;
      this.toggle.setAttribute("aria-pressed", String(shown));
      if (shown) this.fillTable();
    });
    this.box.addEventListener("keydown", (event) => this.onKey(event));
    new ResizeObserver(() => this.resize()).observe(this.box);
  }

  connectedCallback() {
    this.setAttribute("role", "group");
    this.setAttribute("aria-labelledby", "waveform-title");
    this.append(
      el(
        "div",
        { class: "card-head" },
        el("div", {}, this.heading, this.subtitle),
        el("div", { class: "card-actions" }, this.toggle),
      ),
      this.readouts,
      this.box,
      this.tableBox,
    );
  }

  /** @param {string} position @param {string} label */
  select(position, label) {
    this.waveform = null;
    this.plot?.destroy();
    this.plot = null;
    this.emptyText.hidden = false;
    this.position = position;
    this.setLive(this.live);
    setText(this.subtitle, label);
    setText(this.readout, "");
    this.label = label;
    this.readouts.replaceChildren();
    delete this.dataset.sequence;
  }

  /** Show whether more waveforms follow: after the test this is the last one. @param {boolean} live */
  setLive(live) {
    this.live = live;
    if (this.position) setText(this.heading, `${live ? "Live" : "Last"} waveform · ${this.position}`);
  }

  /** @param {Waveform} waveform */
  show(waveform) {
    const sameKind =
      this.waveform?.header.method === waveform.header.method && this.waveform?.volts.length === waveform.volts.length;
    this.waveform = waveform;
    this.received = performance.now();
    this.changes += 1;
    this.dataset.sequence = String(waveform.header.sequence);
    this.dataset.samples = String(waveform.volts.length);
    this.emptyText.hidden = true;
    const { header } = waveform;
    setText(
      this.subtitle,
      `${this.label} · hour ${hour(header.due_h)}, ${setName(setKey(header))}, shot ` +
        `${header.shot_index}${header.flags.length ? ` · flags: ${header.flags.join(", ")}` : " · no flags"}`,
    );
    this.fillReadouts();
    this.box.setAttribute(
      "aria-label",
      `Waveform of position ${header.position}: ` +
        `${[...this.readouts.children].map((group) => group.textContent).join("; ")}`,
    );
    if (this.plot && sameKind) this.plot.setData([waveform.micros, waveform.volts]);
    else this.draw();
    if (!this.tableBox.hidden) this.fillTable();
  }

  fillReadouts() {
    const { header, volts } = /** @type {Waveform} */ (this.waveform);
    const groups = [];
    if (header.method === "solitary_wave") {
      for (const pulse of PULSES) {
        const time = header.marks[pulse.time];
        const height = header.marks[pulse.height];
        groups.push([
          `${pulse.name} (${pulse.long})`,
          time === null ? NONE : `${quantity(time, 1e6, 1, "µs")} · ${quantity(height, 1, 3, "V")}`,
        ]);
      }
      const { isw_time_s: isw, psw_time_s: psw, isw_amplitude_v: a, psw_amplitude_v: b } = header.marks;
      groups.push(["Peak to peak, PSW − ISW", isw === null || psw === null ? NONE : quantity(psw - isw, 1e6, 2, "µs")]);
      groups.push(["PSW / ISW", a && b ? fixed(b / a, 3) : NONE]);
    } else {
      let peak = 0;
      for (const value of volts) peak = Math.max(peak, Math.abs(value));
      groups.push(
        ["Samples", `${volts.length} at ${fixed(header.sample_rate_hz / 1e6, 0)} MS/s`],
        ["Maximum amplitude", quantity(peak, 1, 3, "V")],
      );
    }
    this.readouts.replaceChildren(
      ...groups.map(([name, value]) => el("div", {}, el("dt", { text: name }), el("dd", { text: value }))),
    );
  }

  fillTable() {
    if (!this.waveform) return;
    const { micros, volts } = this.waveform;
    const step = Math.max(1, Math.ceil(volts.length / 400));
    const body = el("tbody");
    for (let k = 0; k < volts.length; k += step) {
      body.append(el("tr", {}, el("td", { text: micros[k].toFixed(2) }), el("td", { text: volts[k].toFixed(4) })));
    }
    const head = el(
      "tr",
      {},
      el("th", { scope: "col", text: "Time from the trigger (µs)" }),
      el("th", { scope: "col", text: "Sensor voltage (V)" }),
    );
    this.tableBox.replaceChildren(
      el(
        "table",
        {},
        el("caption", { text: `Every ${step}th of ${volts.length} samples; all of them are in the API` }),
        el("thead", {}, head),
        body,
      ),
    );
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    const steps = /** @type {Record<string, number>} */ ({ ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20 });
    const step = steps[event.key];
    if (step === undefined || !this.plot) return;
    event.preventDefault();
    const left = Math.max(
      0,
      (this.plot.cursor.left < 0 ? this.plot.over.clientWidth / 2 : this.plot.cursor.left) + step * 3,
    );
    this.plot.setCursor({ left: Math.min(left, this.plot.over.clientWidth), top: this.plot.over.clientHeight / 2 });
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.box;
    if (this.plot && width && height) this.plot.setSize({ width, height });
    else if (!this.plot && this.waveform) this.draw();
  }

  /** Draw again, e.g. in the colors of another theme. */
  draw() {
    this.plot?.destroy();
    this.plot = null;
    const { clientWidth: width, clientHeight: height } = this.box;
    if (!this.waveform || !width || !height) return;
    const axis = axisLook();
    this.plot = new uPlot(
      {
        width,
        height,
        padding: [18, 12, 0, 0],
        legend: { show: false },
        cursor: { drag: { x: true, y: false } },
        scales: {
          x: { time: false },
          y: {
            range: (/** @type {any} */ _u, /** @type {number} */ min, /** @type {number} */ max) => {
              const pad = Math.max(0.08 * (max - min), 1e-3);
              return [min - pad, max + pad];
            },
          },
        },
        axes: [
          { ...axis, label: "Time from the trigger (µs)", size: 26, labelSize: 20 },
          { ...axis, label: "Sensor voltage (V)", size: 52, labelSize: 18 },
        ],
        series: [{}, { stroke: color("--data"), width: 1.5, points: { show: false } }],
        hooks: {
          draw: [(/** @type {any} */ u) => this.drawMarks(u)],
          setCursor: [
            (/** @type {any} */ u) => {
              const index = u.cursor.idx;
              const waveform = this.waveform;
              setText(
                this.readout,
                waveform && index !== null && index !== undefined
                  ? `${waveform.micros[index].toFixed(2)} µs · ${waveform.volts[index].toFixed(4)} V`
                  : "",
              );
            },
          ],
        },
      },
      /** @type {any} */ ([this.waveform.micros, this.waveform.volts]),
      this.box,
    );
  }

  /** @param {any} u */
  drawMarks(u) {
    const { header } = /** @type {Waveform} */ (this.waveform);
    if (header.method === "solitary_wave") drawPulses(u, marksOf(header.marks));
  }

  /** Return copies of what is drawn, for tests and the console. */
  snapshot() {
    return this.waveform === null
      ? null
      : {
          header: structuredClone(this.waveform.header),
          volts: [...this.waveform.volts],
          micros: [...this.waveform.micros],
          changes: this.changes,
          drawn: Boolean(this.plot),
        };
  }
}
