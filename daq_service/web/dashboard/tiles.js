// Show one tile per position: its name, its state and the age of its data.

import { el, setText } from "./dom.js";
import { NONE, duration, fixed, hour, quantity, significant, utc } from "./format.js";
import { STATES, chip } from "./icons.js";
import { diagnosisText, limitOf } from "./assessment.js";

const SVG = "http://www.w3.org/2000/svg";

/** Return the position of a ratio on the gauge: 0.01 to 100 times the limit, logarithmic. @param {number} ratio */
function onGauge(ratio) {
  return Math.max(0, Math.min(1, (Math.log10(Math.max(ratio, 1e-9)) + 2) / 4));
}

/** @param {number | null} ratio */
function gauge(ratio) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "gauge");
  svg.setAttribute("viewBox", "0 0 200 10");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("aria-hidden", "true");
  const add = (/** @type {string} */ tag, /** @type {Record<string, string>} */ attributes) => {
    const element = document.createElementNS(SVG, tag);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    svg.append(element);
    return element;
  };
  add("rect", { class: "gauge-track", x: "0.5", y: "2.5", width: "199", height: "5", rx: "2" });
  if (ratio !== null) {
    const value = add("rect", {
      class: "gauge-value",
      x: "0.5",
      y: "2.5",
      width: String(199 * onGauge(ratio)),
      height: "5",
      rx: "2",
    });
    value.dataset.over = String(ratio > 1);
  }
  add("line", { class: "gauge-limit", x1: "100", x2: "100", y1: "0", y2: "10" });
  return svg;
}

/** @param {[string, string][]} values */
function list(values) {
  return el(
    "dl",
    { class: "tile-values" },
    ...values.map(([name, value]) => el("div", {}, el("dt", { text: name }), el("dd", { text: value }))),
  );
}

export class Tiles {
  /** @param {HTMLElement} root */
  constructor(root) {
    this.root = root;
    /** Called when a click or an arrow key selects a position. @type {(position: string) => void} */
    this.onSelect = () => {};
    this.selected = "";
    /** @type {any[]} */
    this.states = [];
    this.readAt = 0;
    this.online = false;
    this.lossLimit = 0;
    /** @type {any} */
    this.asOf = null;
    root.addEventListener("keydown", (event) => this.onKey(event));
  }

  /** @param {any} answer of /transducers */
  update(answer) {
    // The answers embedded in the page are passed again when the other scripts have loaded; their age counts from the
    // first time.
    if (this.asOf !== answer.as_of) this.readAt = performance.now();
    this.states = answer.items;
    this.asOf = answer.as_of;
    const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.position;
    this.root.replaceChildren(...this.states.map((state) => this.tile(state)));
    if (focused) /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-position="${focused}"]`))?.focus();
    this.tick();
  }

  /** @param {string} position */
  select(position) {
    this.selected = position;
    for (const tile of this.root.querySelectorAll(".tile")) {
      const chosen = /** @type {HTMLElement} */ (tile).dataset.position === position;
      tile.setAttribute("aria-checked", String(chosen));
      tile.setAttribute("tabindex", chosen ? "0" : "-1");
    }
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    const steps = /** @type {Record<string, number>} */ ({ ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 });
    const step = steps[event.key];
    if (step === undefined || !this.states.length) return;
    event.preventDefault();
    const at = this.states.findIndex((state) => state.position === this.selected);
    const next = this.states[(at + step + this.states.length) % this.states.length].position;
    this.onSelect(next);
    /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-position="${next}"]`))?.focus();
  }

  /** Return the seconds since the recorder's last write. */
  wallAgeS() {
    return this.asOf?.wall_age_s === null || !this.asOf
      ? null
      : this.asOf.wall_age_s + (performance.now() - this.readAt) / 1000;
  }

  /** Update the ages, which grow without new data; called every second. */
  tick() {
    const wall = this.wallAgeS();
    for (const tile of this.root.querySelectorAll(".tile")) {
      const state = this.states.find((one) => one.position === /** @type {HTMLElement} */ (tile).dataset.position);
      const stale = state.stale || !this.online;
      /** @type {HTMLElement} */ (tile).dataset.stale = String(stale);
      const age = tile.querySelector(".tile-age");
      if (!age) continue;
      const text =
        state.age_h === null
          ? "nothing recorded yet"
          : `${stale ? "Stale: " : ""}hour ${hour(state.data_h)} · ${fixed(state.age_h, 1)} h old · written ` +
            `${wall === null ? NONE : duration(wall)} ago`;
      setText(age, text);
    }
  }

  /** @param {any} state @returns {HTMLElement} */
  tile(state) {
    const stateLook = STATES[state.state] ?? STATES.no_data;
    const body = state.method === "pulse_echo" ? this.pulseEcho(state) : this.solitaryWave(state);
    const chosen = state.position === this.selected;
    const tile = el(
      "div",
      {
        class: "tile",
        role: "radio",
        "aria-checked": String(chosen),
        tabindex: chosen ? "0" : "-1",
        "aria-label": `Position ${state.position}, ${state.label}: ${stateLook.label}`,
      },
      el(
        "div",
        { class: "tile-head" },
        el("span", { class: "tile-name", text: state.position }),
        el("span", { class: "tile-label", text: state.label }),
        chip(stateLook),
      ),
      ...body,
      ...(state.suppressed_alarms
        ? [
            el("p", {
              class: "quiet small",
              text:
                `${state.suppressed_alarms} shelved or out of ` +
                `service${state.shelved_until_utc ? `, until ${utc(state.shelved_until_utc)}` : ""}`,
            }),
          ]
        : []),
      el("p", { class: "tile-age" }),
    );
    tile.dataset.position = state.position;
    tile.dataset.state = state.state;
    tile.addEventListener("click", () => this.onSelect(state.position));
    return tile;
  }

  /** @param {any} state @returns {Element[]} */
  solitaryWave(state) {
    const { last_assessment: assessment } = state;
    const feature = state.last_feature;
    const limit = assessment ? limitOf(assessment) : null;
    const ratio =
      assessment && limit && assessment.distance_squared !== null ? assessment.distance_squared / limit : null;
    const note =
      ratio === null
        ? (assessment?.reason ?? "no limit yet")
        : `× limit (D² ${significant(assessment.distance_squared)} of ${significant(limit)})`;
    return [
      el(
        "div",
        { class: "tile-figure" },
        el("span", { class: "figure", text: ratio === null ? NONE : significant(ratio) }),
        el("span", { class: "figure-note", text: note }),
      ),
      gauge(ratio),
      list([
        ...(assessment?.diagnosis ? [/** @type {[string, string]} */ (["Cause", diagnosisText(assessment)])] : []),
        ...(typeof assessment?.mewma_statistic === "number" && assessment.limits?.mewma
          ? [
              /** @type {[string, string]} */ ([
                "Chart",
                `${significant(assessment.mewma_statistic)}, limit ${significant(assessment.limits.mewma)}`,
              ]),
            ]
          : []),
        ["Time of flight", quantity(feature?.tof_pp_s, 1e6, 2, "µs")],
        ["Amplitude ratio", fixed(feature?.amplitude_ratio, 3)],
        ["Quality", feature ? `${feature.quality}, n = ${feature.n_valid}` : NONE],
      ]),
    ];
  }

  /** @param {any} state @returns {Element[]} */
  pulseEcho(state) {
    const row = state.last_thickness;
    const initial =
      row && row.thickness_m !== null && row.thickness_loss_m !== null ? row.thickness_m + row.thickness_loss_m : null;
    const fraction = initial ? row.thickness_loss_m / initial : null;
    const ratio = fraction === null || !this.lossLimit ? null : fraction / this.lossLimit;
    return [
      el(
        "div",
        { class: "tile-figure" },
        el("span", { class: "figure", text: quantity(row?.thickness_m, 1e3, 2, "mm") }),
        el("span", {
          class: "figure-note",
          text:
            fraction === null
              ? "wall thickness"
              : `${fixed(100 * fraction, 1)} % lost, limit ${fixed(100 * this.lossLimit, 0)} %`,
        }),
      ),
      gauge(ratio),
      list([
        ["Loss", quantity(row?.thickness_loss_m, 1e3, 2, "mm")],
        ["Travel time", quantity(row?.travel_time_s, 1e6, 3, "µs")],
        ["Quality", row ? row.quality : NONE],
      ]),
    ];
  }
}
