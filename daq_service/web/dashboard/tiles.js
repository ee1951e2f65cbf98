// Show one tile per position: its name, its state and the age of its data.

import { el, setText } from "./dom.js";
import { NONE, duration, fixed, hour, quantity, significant, time } from "./format.js";
import { STATES, chip } from "./icons.js";
import { diagnosisText, limitOf, probabilityText } from "./assessment.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT] = [120, 36];

/**
 * @typedef {object} Trend of a position, for its sparkline
 * @property {number[]} x hours
 * @property {(number | null)[]} y
 * @property {number | null} limit
 * @property {boolean} log
 * @property {number} end_h end of the axis
 */

/**
 * Draw a trend without axes: the line, its limit dashed, a point at the newest value.
 *
 * @param {Trend} trend
 * @param {boolean} alarming
 */
function sparkline({ x, y, limit, log, end_h }, alarming) {
  const scale = (/** @type {number} */ value) => (log ? Math.log10(Math.max(value, 1e-3)) : value);
  const known = [...x.keys()].filter((k) => y[k] !== null);
  const values = known.map((k) => scale(/** @type {number} */ (y[k])));
  const all = limit === null ? values : [...values, scale(limit)];
  const [low, high] = [Math.min(...all), Math.max(...all)];
  const px = (/** @type {number} */ hour) => (2 + ((WIDTH - 4) * hour) / end_h).toFixed(1);
  const py = (/** @type {number} */ value) =>
    (HEIGHT - 3 - ((HEIGHT - 6) * (value - low)) / (high - low || 1)).toFixed(1);
  const make = (/** @type {string} */ tag, /** @type {Record<string, string>} */ attributes) => {
    const element = document.createElementNS(SVG, tag);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    return element;
  };
  const svg = make("svg", { class: "sparkline", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" });
  if (!known.length) return svg;
  if (limit !== null) svg.append(make("path", { class: "sparkline-limit", d: `M0 ${py(scale(limit))}H${WIDTH}` }));
  const points = known.map((k, n) => [px(x[k]), py(values[n])]);
  const [cx, cy] = points[points.length - 1];
  svg.append(
    make("path", { class: "sparkline-line", d: `M${points.join("L")}` }),
    make("circle", { class: alarming ? "sparkline-last alarming" : "sparkline-last", cx, cy, r: "3" }),
  );
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

/**
 * Return the wall thickness from the waves with its 90 % interval, or why there is none, and whether it is below its
 * minimum or when it will be.
 *
 * @param {any} row of `/wall`
 * @param {number | null} newest_h hour of the newest set: the wall's own is told if it is another one
 * @returns {[string, string][]}
 */
function wallValues(row, newest_h) {
  const interval = `${fixed(1e3 * row.interval_low_m, 2)} to ${fixed(1e3 * row.interval_high_m, 2)}, 90 %`;
  const at = row.due_h === newest_h ? "" : `; hour ${hour(row.due_h)}`;
  const doubt = row.quality === "good" ? at : `${at}; ${row.quality}`;
  const wall = `${quantity(row.thickness_m, 1e3, 2, "mm")} (${interval}${doubt})`;
  /** @type {[string, string][]} */
  const values = [["Wall", row.thickness_m === null ? row.reason : wall]];
  const { below_minimum_probability: below, time_to_minimum_s: left } = row;
  if (below !== null) {
    const later = left ? `, at this rate in ${quantity(left, 1 / 86400, 0, "d")}` : "";
    values.push([`Below ${quantity(row.minimum_m, 1e3, 2, "mm")}`, probabilityText(below) + later]);
  }
  return values;
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
    /** Answer of /info. @type {any} */
    this.info = null;
    /** Statistic that raises alarms: of the control chart, or D². */
    this.chartDecides = true;
    /** @type {Map<string, Trend>} by position */
    this.trends = new Map();
    /** Most urgent active alarm by position. @type {Map<string, any>} */
    this.alarms = new Map();
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
    this.render();
  }

  /** Show the limits and rule of the test. @param {any} info answer of /info */
  setLimits(info) {
    this.info = info;
    this.chartDecides = info.limits.decides_by === "chart";
  }

  /**
   * Show what the positions have measured so far, on one time axis.
   *
   * @param {import("./data-loader.js").DataLoader} loader
   * @param {number} end_h of the axis
   */
  showTrends(loader, end_h) {
    for (const [position, { columns, method }] of loader.trends) {
      const probe = method === "pulse_echo";
      const y = probe ? columns.thickness_m : this.chartDecides ? columns.mewma_statistic : columns.distance_squared;
      const limits = loader.baselines.get(position)?.at(-1)?.row.limits;
      const limit = this.chartDecides ? limits?.mewma : limits?.f_predictive;
      const least = this.minimumWall(position);
      this.trends.set(position, { x: columns.due_h, y, limit: (probe ? least : limit) ?? null, log: !probe, end_h });
    }
    this.render();
  }

  /** Return the thickness in m that raises the alarm of a probe. @param {string} position @returns {number | null} */
  minimumWall(position) {
    const known = this.info?.positions.find((/** @type {any} */ one) => one.position === position);
    return known?.minimum_wall_m ?? null;
  }

  /** @param {any[]} active alarms, the most urgent first */
  showAlarms(active) {
    this.alarms.clear();
    for (const alarm of active) if (!this.alarms.has(alarm.position)) this.alarms.set(alarm.position, alarm);
    this.render();
  }

  render() {
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
      // The last values of a finished test are its result.
      const stale = !this.online || (state.stale && this.asOf.recorder !== "finished");
      /** @type {HTMLElement} */ (tile).dataset.stale = String(stale);
      const age = tile.querySelector(".tile-age");
      if (!age) continue;
      const text =
        state.age_h === null
          ? "nothing recorded yet"
          : `${stale ? "Stale: " : ""}hour ${hour(state.data_h)} · ${fixed(state.age_h, 1)} h old · updated ` +
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
                `service${state.shelved_until_utc ? `, until ${time(state.shelved_until_utc)}` : ""}`,
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

  /**
   * Return the statistic of a position that raises alarms, or that raised the active one.
   *
   * @param {any} state
   * @returns {{figure: string, note: string}}
   */
  statistic({ position, last_assessment: assessment }) {
    const alarm = this.alarms.get(position);
    const probability = assessment?.diagnosis_probability ?? null;
    if (alarm?.evidence.raised_by === "diagnosis" && probability !== null && assessment.diagnosis !== "undetermined")
      return { figure: probabilityText(probability), note: `model: ${assessment.diagnosis}` };
    const [value, limit, name] = this.chartDecides
      ? [assessment?.mewma_statistic, assessment?.limits?.mewma, "control chart"]
      : [assessment?.distance_squared, assessment ? limitOf(assessment) : null, "D²"];
    if (typeof value !== "number" || !limit) return { figure: NONE, note: assessment?.reason ?? "no limit yet" };
    return {
      figure: `${Number((value / limit).toPrecision(2))} × limit`,
      note: `${name} ${significant(value)}, limit ${significant(limit)}`,
    };
  }

  /**
   * @param {any} state
   * @param {string} figure
   * @param {string} note
   * @param {[string, string][]} values
   */
  body(state, figure, note, values) {
    const trend = this.trends.get(state.position);
    return [
      el(
        "div",
        { class: "tile-figure" },
        el("div", {}, el("p", { class: "figure", text: figure }), el("p", { class: "figure-note", text: note })),
        ...(trend ? [sparkline(trend, state.state === "alarm")] : []),
      ),
      list(values),
    ];
  }

  /** @param {any} state @returns {Element[]} */
  solitaryWave(state) {
    const { last_assessment: assessment, last_feature: feature } = state;
    const { figure, note } = this.statistic(state);
    /** @type {[string, string][]} */
    const values = [
      ["Time of flight", quantity(feature?.tof_pp_s, 1e6, 2, "µs")],
      ["Amplitude ratio", fixed(feature?.amplitude_ratio, 3)],
      ["Quality", feature?.quality ?? NONE],
    ];
    if (assessment?.diagnosis) values.unshift(["Diagnosis", diagnosisText(assessment)]);
    if (state.last_wall) values.unshift(...wallValues(state.last_wall, state.data_h));
    return this.body(state, figure, note, values);
  }

  /** @param {any} state @returns {Element[]} */
  pulseEcho(state) {
    const row = state.last_thickness;
    const initial =
      row && row.thickness_m !== null && row.thickness_loss_m !== null ? row.thickness_m + row.thickness_loss_m : null;
    const assumed = this.info?.probe_delay_is_assumed ? ", probe delay assumed" : "";
    const lost = initial ? `, ${fixed((100 * row.thickness_loss_m) / initial, 0)} %` : "";
    const [low, high] = [row?.interval_low_m ?? null, row?.interval_high_m ?? null];
    const interval =
      low === null || high === null
        ? "wall thickness"
        : `${fixed(1e3 * low, 2)} to ${quantity(high, 1e3, 2, "mm")} (95 %${assumed})`;
    return this.body(state, quantity(row?.thickness_m, 1e3, 2, "mm"), interval, [
      ["Wall loss", `${quantity(row?.thickness_loss_m, 1e3, 2, "mm")}${lost}`],
      ["Limit", quantity(this.minimumWall(state.position), 1e3, 2, "mm")],
      ["Travel time", quantity(row?.travel_time_s, 1e6, 3, "µs")],
      ["Quality", row?.quality ?? NONE],
    ]);
  }
}
