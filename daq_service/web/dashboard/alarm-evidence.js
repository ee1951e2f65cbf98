// Build the evidence of an alarm: the service's sentences, a chart of the sets around it, and the raw data.

import { get, trend } from "./api.js";
import { shownUnit } from "./charts/series.js";
import { el, setText } from "./dom.js";
import { fixed, hour } from "./format.js";

/** Scheduled sets of the chart before and after the one that raised the alarm. */
const BEFORE = 12;
const AFTER = 8;

/**
 * @typedef {object} AssessedSet one set
 * @property {number} set @property {number} hour @property {number | null} value
 * @property {string | null} quality @property {boolean | null} exceeds its limit; null: not assessed
 *
 * @typedef {object} Host
 * @property {(position: string) => any} trend of the complete test
 * @property {() => import("./timeline.js").Timeline} timeline
 * @property {(position: string, set: import("./format.js").SetKey) => void} open
 * @property {(hour: number, ask: boolean) => void} note
 */

/**
 * @param {string[]} fields of /trends, the assessed one first
 * @param {(columns: any, k: number, evidence: any) => boolean | null} exceeds
 */
const trendReader = (fields, exceeds) => async (/** @type {any} */ alarm, /** @type {any} */ range) => {
  const { columns } = await trend(alarm.position, fields, range);
  return columns.set_index.map((/** @type {number} */ set, /** @type {number} */ k) => ({
    set,
    hour: columns.due_h[k],
    value: columns[fields[0]][k],
    quality: columns.quality[k],
    exceeds: exceeds(columns, k, alarm.evidence),
  }));
};

/** @param {any} alarm @param {{from_h: number, to_h: number}} range @returns {Promise<AssessedSet[]>} */
async function readValidShots(alarm, { from_h, to_h }) {
  const { items } = await get(`/sets?position=${alarm.position}&from_h=${from_h}&to_h=${to_h}&limit=100`);
  const minimum = alarm.evidence.minimum_valid_shots;
  return items.map((/** @type {any} */ set) => ({
    set: set.set_index,
    hour: set.due_h,
    value: set.n_valid,
    quality: null,
    exceeds: minimum === undefined || set.n_planned === 0 ? null : set.n_valid < minimum,
  }));
}

const SHOTS = {
  name: "Valid shots",
  short: "valid shots",
  unit: "1",
  digits: 0,
  limit: "minimum_valid_shots",
  read: readValidShots,
};
const WALL = ["distance_squared", "outlier"];
/**
 * What each kind assesses: its name and format, the key of its limit in the evidence, and where it is read.
 *
 * @type {Record<string, {name: string, short: string, unit: string, digits: number, limit: string, log?: boolean,
 *   source?: {fields: string[], method: string}, read: (alarm: any, range: any) => Promise<AssessedSet[]>}>}
 */
const KINDS = {
  wall_change: {
    name: "Squared distance D²",
    short: "D²",
    unit: "1",
    digits: 2,
    limit: "limit",
    log: true,
    source: { fields: WALL, method: "solitary_wave" },
    read: trendReader(WALL, ({ outlier }, k) => outlier[k]),
  },
  thickness_low: {
    ...{
      name: "Wall thickness",
      short: "thickness",
      unit: "m",
      digits: 3,
      limit: "limit_m",
      source: { fields: ["thickness_m"], method: "pulse_echo" },
    },
    // The complete interval is below the limit; of readings without one, the thickness. In between: unknown.
    read: trendReader(["thickness_m", "interval_high_m"], ({ thickness_m, interval_high_m, quality }, k, evidence) => {
      const upper = interval_high_m[k] ?? thickness_m[k];
      if (upper === null || quality[k] === "bad") return null;
      return upper < evidence.limit_m || (thickness_m[k] !== null && thickness_m[k] < evidence.limit_m ? null : false);
    }),
  },
  few_valid_shots: SHOTS,
  transducer_disabled: SHOTS,
  no_reflection: SHOTS,
};
KINDS.transducer_change = KINDS.wall_change;

/** An alarm of a wall that the control chart raised. @type {typeof KINDS[string]} */
const BY_CHART = {
  ...KINDS.wall_change,
  name: "Control chart (MEWMA)",
  short: "control chart",
  source: { fields: ["mewma_statistic"], method: "solitary_wave" },
  read: trendReader(["mewma_statistic"], ({ mewma_statistic: chart }, k, { limit }) =>
    chart[k] === null ? null : chart[k] > limit,
  ),
};

/**
 * Return a link to a set, which can be copied and sent like any other view.
 *
 * @param {string} position
 * @param {import("./format.js").SetKey} set
 * @param {string} text
 * @param {Record<string, string>} attributes
 * @param {Host["open"]} open
 */
export function setLink(position, set, text, attributes, open) {
  const link = el("a", { class: "small", href: `?position=${position}&set=${set}`, text, ...attributes });
  link.addEventListener("click", (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    open(position, set);
  });
  return link;
}

export class AlarmEvidence {
  /** @param {any} alarm @param {Host} host */
  constructor(alarm, host) {
    this.alarm = alarm;
    this.host = host;
    this.sentences = el("ul", { class: "evidence-sentences" });
    this.raw = el("pre", { class: "evidence", tabindex: "0" });
    this.trouble = el("p", { class: "quiet", role: "status" });
    this.sets = el("ul", { class: "evidence-sets" });
    /** @type {import("./charts/chart.js").SolimonChart | null} */
    this.chart = null;
    /** Hour of the newest set when the chart was read. */
    this.newest = -Infinity;
    /** Hours of the chart. @type {import("./charts/gestures.js").Span} */
    this.range = [0, Infinity];
    const stored = el("details", {}, el("summary", { text: "Raw data" }), this.raw);
    this.message = el("p");
    this.root = el("div", { class: "evidence-box" }, this.message, this.sentences, this.trouble, this.sets, stored);
    this.update(alarm);
    void this.read();
  }

  /** @param {any} alarm */
  update(alarm) {
    this.alarm = alarm;
    setText(this.message, alarm.message);
    this.sentences.replaceChildren(...alarm.evidence_sentences.map((/** @type {string} */ text) => el("li", { text })));
    setText(this.raw, JSON.stringify(alarm.evidence, null, 1));
  }

  /** Draw new sets that belong to the chart. */
  renew() {
    if (!this.root.isConnected || this.alarm.position === null || this.newest > this.range[1]) return;
    if ((this.host.trend(this.alarm.position)?.columns.due_h.at(-1) ?? this.newest) > this.newest) void this.read();
  }

  /** Read the sets around the alarm and draw them. */
  async read() {
    const { alarm, host } = this;
    const kind = alarm.evidence.limit_name === "mewma" ? BY_CHART : KINDS[alarm.kind];
    const fullTrend = alarm.position === null ? null : host.trend(alarm.position);
    if (!kind || !fullTrend?.columns.due_h.length) return;
    // The interval of the schedule there, from the hours that the page knows.
    const { due_h: hours, set_index: sets } = fullTrend.columns;
    const found = hours.findIndex((/** @type {number} */ one) => one >= alarm.raised_h);
    const at = found < 0 ? hours.length - 1 : Math.max(found, 1);
    const interval = hours.length > 1 ? (hours[at] - hours[at - 1]) / (sets[at] - sets[at - 1]) : 1;
    try {
      const [from_h, to_h] = (this.range = [
        Math.max(0, alarm.raised_h - (BEFORE + 0.5) * interval),
        alarm.raised_h + (AFTER + 0.5) * interval,
      ]);
      this.newest = hours[hours.length - 1];
      this.show(kind, await kind.read(alarm, { from_h, to_h }), interval);
      setText(this.trouble, "");
    } catch (error) {
      setText(this.trouble, /** @type {Error} */ (error).message);
    }
  }

  /** @param {typeof KINDS[string]} kind @param {AssessedSet[]} assessed @param {number} interval h */
  show(kind, assessed, interval) {
    const { alarm, host } = this;
    const { factor, unit } = shownUnit(kind.unit);
    const inUnit = (/** @type {number | null} */ value) => (value === null ? null : value * factor);
    const limit = inUnit(alarm.evidence[kind.limit] ?? null);
    const lastSet = alarm.raised_set_index ?? Infinity;
    const evaluated = assessed
      .filter((one) => one.exceeds !== null && one.set <= lastSet)
      .slice(-(alarm.evidence.rule?.n ?? alarm.evidence.consecutive_poor_sets ?? 1));
    const exceeds = evaluated.filter((one) => one.exceeds).length;
    // A kind without a limit (hole) is only drawn.
    const subtitle = !evaluated.length
      ? `Position ${alarm.position}`
      : `Position ${alarm.position}: ${exceeds} of the last ${evaluated.length} assessed sets outside the ` +
        "limit when the alarm was raised";
    const x = assessed.map((one) => one.hour);
    const sets = assessed.map((one) => one.set);
    this.chart ??= this.makeChart(kind);
    this.chart.update({
      x,
      lines: [
        {
          key: "assessed",
          label: kind.short,
          short: kind.short,
          color: "--data",
          points: true,
          y: assessed.map((one) => inUnit(one.value)),
          position: alarm.position,
          sets,
          firstSets: sets,
          step: 1,
          quality: assessed.map((one) => one.quality),
          outlier: assessed.map((one) => one.exceeds),
        },
        ...(limit === null
          ? []
          : [
              /** @type {import("./charts/series.js").Line} */ ({
                key: "limit",
                label: "limit",
                short: "limit",
                color: "--limit",
                points: false,
                y: x.map(() => limit),
              }),
            ]),
      ],
      name: unit ? `${kind.name} (${unit})` : kind.name,
      unit,
      digits: kind.digits,
      ranges: evaluated.length
        ? [
            {
              from_h: evaluated[0].hour - interval / 2,
              to_h: evaluated[evaluated.length - 1].hour + interval / 2,
              label: `last ${evaluated.length} assessed`,
              tone: "warn",
            },
          ]
        : [],
      alarms: [alarm.raised_h],
      opened: null,
      subtitle,
      exported: kind.source
        ? {
            ...kind.source,
            ...("below_minimum_probability" in alarm.evidence ? { method: "solitary_wave" } : {}),
            positions: [alarm.position],
          }
        : null,
    });
    this.sets.replaceChildren(
      ...evaluated.map((one) => {
        const value = `${kind.short} ${fixed(inUnit(one.value), kind.digits)}${unit ? ` ${unit}` : ""}`;
        const text = `Set ${one.set}, hour ${hour(one.hour)}: ${value}${one.exceeds ? ", outside the limit" : ""}`;
        return el("li", {}, setLink(alarm.position, one.set, text, {}, host.open));
      }),
    );
  }

  /** @param {typeof KINDS[string]} kind */
  makeChart(kind) {
    const chart = /** @type {import("./charts/chart.js").SolimonChart} */ (document.createElement("solimon-chart"));
    chart.id = `evidence-chart-${this.alarm.id}`;
    /** @type {import("./charts/gestures.js").Span | null} */
    let zoom = null;
    chart.configure(
      {
        title: `Sets around the alarm at ${this.alarm.position}, hour ${hour(this.alarm.raised_h)}: ${kind.short}`,
        log: kind.log,
        empty: "These sets are not stored",
      },
      {
        ...this.host,
        span: () => zoom ?? this.range,
        full: () => this.range,
        show: (to) => {
          zoom = to;
          chart.applySpan();
        },
        table: (_, shown) => chart.showTable(shown),
      },
    );
    // Data that are in no table of the API have no file.
    if (!kind.source) chart.actions.lastElementChild?.remove();
    this.trouble.after(chart);
    return chart;
  }
}
