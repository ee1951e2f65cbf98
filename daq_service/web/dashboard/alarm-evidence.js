// What an alarm rests on: the service's sentences, a picture of the sets around it, and the proof as stored.

import { get, trend } from "./api.js";
import { shownUnit } from "./charts/series.js";
import { el, setText } from "./dom.js";
import { fixed, hour } from "./format.js";

/** Planned sets of the picture before and behind the one that raised the alarm. */
const BEFORE = 12;
const BEHIND = 8;

/**
 * @typedef {object} Judged one set
 * @property {number} set @property {number} hour @property {number | null} value
 * @property {string | null} quality @property {boolean | null} beyond its limit; null: not judged
 *
 * @typedef {object} Host
 * @property {(position: string) => any} trend of the whole test
 * @property {() => import("./timeline.js").Timeline} timeline
 * @property {(position: string, set: number) => void} open
 * @property {(hour: number, ask: boolean) => void} note
 */

/** @param {string[]} fields of /trends, the judged one first @param {(columns: any, k: number, proof: any) => boolean | null} beyond */
const ofTrend = (fields, beyond) => async (/** @type {any} */ alarm, /** @type {any} */ range) => {
  const { columns } = await trend(alarm.position, fields, range);
  return columns.set_index.map((/** @type {number} */ set, /** @type {number} */ k) => ({ set, hour: columns.due_h[k], value: columns[fields[0]][k], quality: columns.quality[k], beyond: beyond(columns, k, alarm.proof) }));
};

/** @param {any} alarm @param {{from_h: number, to_h: number}} range @returns {Promise<Judged[]>} */
async function validShots(alarm, { from_h, to_h }) {
  const { items } = await get(`/sets?position=${alarm.position}&from_h=${from_h}&to_h=${to_h}&limit=100`);
  const least = alarm.proof.minimum_valid_shots;
  return items.map((/** @type {any} */ set) => ({ set: set.set_index, hour: set.due_h, value: set.n_valid, quality: null, beyond: least === undefined || set.n_planned === 0 ? null : set.n_valid < least }));
}

const SHOTS = { name: "Valid shots", short: "valid shots", unit: "1", digits: 0, limit: "minimum_valid_shots", read: validShots };
const WALL = ["distance_squared", "outlier"];
/**
 * What each kind judges: how it is called and shown, the proof's entry that is its limit, and where it is read.
 *
 * @type {Record<string, {name: string, short: string, unit: string, digits: number, limit: string, log?: boolean, taken?: {fields: string[], method: string}, read: (alarm: any, range: any) => Promise<Judged[]>}>}
 */
const KINDS = {
  wall_change: { name: "Squared distance D²", short: "D²", unit: "1", digits: 2, limit: "limit", log: true, taken: { fields: WALL, method: "solitary_wave" }, read: ofTrend(WALL, ({ outlier }, k) => outlier[k]) },
  thickness: {
    ...{ name: "Wall thickness", short: "thickness", unit: "m", digits: 3, limit: "limit_m", taken: { fields: ["thickness_m"], method: "pulse_echo" } },
    read: ofTrend(["thickness_m"], ({ thickness_m: wall, quality }, k, { limit_m }) => (wall[k] === null || quality[k] === "bad" ? null : wall[k] < limit_m)),
  },
  no_data: SHOTS,
  retired: SHOTS,
  hole: SHOTS,
};
KINDS.transducer_change = KINDS.wall_change;

/** A wall's alarm that the chart raised. @type {typeof KINDS[string]} */
const BY_CHART = { ...KINDS.wall_change, name: "Chart", short: "chart", taken: { fields: ["chart"], method: "solitary_wave" }, read: ofTrend(["chart"], ({ chart }, k, { limit }) => (chart[k] === null ? null : chart[k] > limit)) };

/** A link, so that it can be copied and sent as any other view. @param {string} position @param {number} set @param {string} text @param {Record<string, string>} attributes @param {Host["open"]} open */
export function setLink(position, set, text, attributes, open) {
  const link = el("a", { class: "small", href: `?position=${position}&set=${set}`, text, ...attributes });
  link.addEventListener("click", (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    open(position, set);
  });
  return link;
}

export class Proof {
  /** @param {any} alarm @param {Host} host */
  constructor(alarm, host) {
    this.alarm = alarm;
    this.host = host;
    this.sentences = el("ul", { class: "proof-told" });
    this.raw = el("pre", { class: "proof", tabindex: "0" });
    this.trouble = el("p", { class: "quiet", role: "status" });
    this.sets = el("ul", { class: "proof-sets" });
    /** @type {import("./charts/chart.js").SolimonChart | null} */
    this.chart = null;
    /** Hour of the newest set when the picture was read. */
    this.newest = -Infinity;
    /** Hours of the picture. @type {import("./charts/gestures.js").Span} */
    this.range = [0, Infinity];
    const stored = el("details", {}, el("summary", { text: "As stored", "data-focus": `stored-${alarm.id}` }), this.raw);
    this.root = /** @type {HTMLDetailsElement} */ (el("details", { class: "proof-box" }, el("summary", { text: "Proof", "data-focus": `proof-${alarm.id}` }), this.sentences, this.trouble, this.sets, stored));
    this.root.addEventListener("toggle", () => void (this.root.open && this.read()));
    this.update(alarm);
  }

  /** @param {any} alarm */
  update(alarm) {
    this.alarm = alarm;
    this.sentences.replaceChildren(...alarm.proof_sentences.map((/** @type {string} */ text) => el("li", { text })));
    setText(this.raw, JSON.stringify(alarm.proof, null, 1));
  }

  /** Sets have come: draw those that belong to an open picture. */
  renew() {
    if (!this.root.open || this.alarm.position === null || this.newest > this.range[1]) return;
    if ((this.host.trend(this.alarm.position)?.columns.due_h.at(-1) ?? this.newest) > this.newest) void this.read();
  }

  /** Read the sets around the alarm, and draw them. */
  async read() {
    const { alarm, host } = this;
    const kind = alarm.proof.limit_name === "chart" ? BY_CHART : KINDS[alarm.kind];
    const whole = alarm.position === null ? null : host.trend(alarm.position);
    if (!kind || !whole?.columns.due_h.length) return;
    // The plan's interval there, from the hours that the page knows.
    const { due_h: hours, set_index: sets } = whole.columns;
    const found = hours.findIndex((/** @type {number} */ one) => one >= alarm.raised_h);
    const at = found < 0 ? hours.length - 1 : Math.max(found, 1);
    const interval = hours.length > 1 ? (hours[at] - hours[at - 1]) / (sets[at] - sets[at - 1]) : 1;
    try {
      const [from_h, to_h] = (this.range = [Math.max(0, alarm.raised_h - (BEFORE + 0.5) * interval), alarm.raised_h + (BEHIND + 0.5) * interval]);
      this.newest = hours[hours.length - 1];
      this.show(kind, await kind.read(alarm, { from_h, to_h }), interval);
      setText(this.trouble, "");
    } catch (error) {
      setText(this.trouble, /** @type {Error} */ (error).message);
    }
  }

  /** @param {typeof KINDS[string]} kind @param {Judged[]} judged @param {number} interval h */
  show(kind, judged, interval) {
    const { alarm, host } = this;
    const { factor, unit } = shownUnit(kind.unit);
    const inUnit = (/** @type {number | null} */ value) => (value === null ? null : value * factor);
    const limit = inUnit(alarm.proof[kind.limit] ?? null);
    const upTo = alarm.raised_set_index ?? Infinity;
    const counted = judged.filter((one) => one.beyond !== null && one.set <= upTo).slice(-(alarm.proof.rule?.n ?? alarm.proof.poor_sets_running ?? 1));
    const beyond = counted.filter((one) => one.beyond).length;
    // A kind without a limit of its own (hole) is only drawn.
    const told = !counted.length ? `Position ${alarm.position}` : `Position ${alarm.position}: ${beyond} of the last ${counted.length} judged sets beyond the limit when the alarm was raised`;
    const x = judged.map((one) => one.hour);
    const sets = judged.map((one) => one.set);
    this.chart ??= this.makeChart(kind);
    this.chart.update({
      x,
      lines: [
        { key: "judged", label: kind.short, short: kind.short, color: "--data", points: true, y: judged.map((one) => inUnit(one.value)), position: alarm.position, sets, firsts: sets, step: 1, quality: judged.map((one) => one.quality), outlier: judged.map((one) => one.beyond) },
        ...(limit === null ? [] : [/** @type {import("./charts/series.js").Line} */ ({ key: "limit", label: "limit", short: "limit", color: "--limit", points: false, y: x.map(() => limit) })]),
      ],
      name: unit ? `${kind.name} (${unit})` : kind.name,
      unit,
      digits: kind.digits,
      ranges: counted.length ? [{ from_h: counted[0].hour - interval / 2, to_h: counted[counted.length - 1].hour + interval / 2, word: `last ${counted.length} judged`, tone: "warn" }] : [],
      alarms: [alarm.raised_h],
      opened: null,
      subtitle: told,
      endHour: this.range[1],
      taken: kind.taken ? { ...kind.taken, positions: [alarm.position] } : null,
    });
    this.sets.replaceChildren(
      ...counted.map((one) => {
        const value = `${kind.short} ${fixed(inUnit(one.value), kind.digits)}${unit ? ` ${unit}` : ""}`;
        const text = `Set ${one.set}, hour ${hour(one.hour)}: ${value}${one.beyond ? ", beyond the limit" : ""}`;
        return el("li", {}, setLink(alarm.position, one.set, text, { "data-focus": `judged-${alarm.id}-${one.set}` }, host.open));
      }),
    );
  }

  /** @param {typeof KINDS[string]} kind */
  makeChart(kind) {
    const chart = /** @type {import("./charts/chart.js").SolimonChart} */ (document.createElement("solimon-chart"));
    chart.id = `proof-chart-${this.alarm.id}`;
    /** @type {import("./charts/gestures.js").Span | null} */
    let zoom = null;
    chart.configure(
      { title: `Sets around the alarm at ${this.alarm.position}, hour ${hour(this.alarm.raised_h)}: ${kind.short}`, log: kind.log, empty: "None of these sets is stored" },
      {
        ...this.host,
        span: () => zoom ?? this.range,
        show: (to) => {
          zoom = to;
          chart.respan();
        },
        table: (_, shown) => chart.showTable(shown),
      },
    );
    // Of what no table of the API holds there is no file.
    if (!kind.taken) chart.actions.lastElementChild?.remove();
    this.trouble.after(chart);
    return chart;
  }
}
