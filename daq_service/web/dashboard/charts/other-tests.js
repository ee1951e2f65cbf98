// Series of other tests of this service, by hours since each one's hour 0; which ones, the address says.

import { BASE, get, trend } from "../api.js";
import { FIELDS } from "../data-loader.js";
import { livesOf } from "./baselines.js";

const REFRESH_MS = 5000;

/** @typedef {{test: string, position: string}} Where */

/** Entries of `compare` are positions of this test, or `TEST:POSITION` of another. @param {string} entry */
export const isOther = (entry) => entry.includes(":");

/** @param {string} entry @returns {Where} */
export function whereOf(entry) {
  const [test, position] = entry.split(":");
  return { test, position };
}

/** As a legend says it. @param {string} entry */
export const nameOf = (entry) => entry.replace(":", " ");

/** Where a test is, as `api.js` wants it. @param {string} test */
const baseOf = (test) => `/tests/${encodeURIComponent(test)}`;

export class Others {
  /** @param {() => void} onChange lists or series are new */
  constructor(onChange) {
    this.onChange = onChange;
    /** @type {any[]} the other tests, as the service lists them */
    this.items = [];
    /** When they were read, by `performance.now()`. */
    this.readAt = 0;
    /** @type {Map<string, any>} columns by entry */
    this.trends = new Map();
    /** Baselines by entry, the present one last. @type {Map<string, import("./baselines.js").Life[]>} */
    this.lives = new Map();
    /** @type {Map<string, string>} why an entry is not drawn */
    this.troubles = new Map();
    /** @type {string[]} */
    this.chosen = [];
    this.feature = "";
    /** @type {[number, number] | null} */
    this.span = null;
    this.asked = "";
    this.reading = false;
  }

  /** @param {import("../view.js").View} view */
  choose(view) {
    if (BASE === "") return;
    this.chosen = view.compare.filter(isOther);
    this.feature = view.feature;
    this.span = view.from_h === null || view.to_h === null ? null : [view.from_h, view.to_h];
    const asked = JSON.stringify([this.chosen, this.feature, this.chosen.length ? this.span : null]);
    if (asked === this.asked) return;
    const first = this.asked === "";
    this.asked = asked;
    for (const one of [...this.trends.keys()]) if (!this.chosen.includes(one)) this.forget(one);
    if (first) void this.readOn();
    else void this.read();
  }

  /** @param {string} entry */
  forget(entry) {
    for (const kept of [this.trends, this.lives, this.troubles]) kept.delete(entry);
  }

  /** @param {string} entry @returns {any} how the service lists its test */
  listed(entry) {
    return this.items.find((item) => item.test === whereOf(entry).test);
  }

  /** @param {string} entry @returns {any} how its position stands */
  place(entry) {
    return this.listed(entry)?.standing?.positions.find((/** @type {any} */ place) => place.position === whereOf(entry).position);
  }

  /** Again and again, each time once the answers have come. */
  async readOn() {
    if (!document.hidden) await this.read();
    setTimeout(() => this.readOn(), REFRESH_MS);
  }

  async read() {
    if (this.reading) return;
    this.reading = true;
    const { asked } = this;
    try {
      const { items } = await get("/tests", "");
      this.items = items.filter((/** @type {any} */ item) => item.page !== `${BASE}/`);
      this.readAt = performance.now();
      await Promise.all(this.chosen.map((entry) => this.readOne(entry)));
    } catch (error) {
      for (const entry of this.chosen) this.troubles.set(entry, /** @type {Error} */ (error).message);
    }
    this.reading = false;
    this.onChange();
    if (asked !== this.asked) void this.read();
  }

  /** @param {string} entry */
  async readOne(entry) {
    const { test, position } = whereOf(entry);
    const place = this.place(entry);
    if (!place) {
      this.troubles.set(entry, this.listed(entry)?.detail ?? `this service has no ${nameOf(entry)}`);
      this.trends.delete(entry);
      return;
    }
    try {
      const base = baseOf(test);
      const { schedule } = await get("/info", base);
      const lives = await livesOf(position, place.method, schedule.baseline_h, this.lives.get(entry), base);
      this.lives.set(entry, lives);
      const fields = [...FIELDS[place.method]];
      if (this.feature in lives[lives.length - 1].trend.columns && !fields.includes(this.feature)) fields.push(this.feature);
      const { span } = this;
      const wide = span ? { from_h: Math.max(0, span[0] - (span[1] - span[0]) / 2), to_h: span[1] + (span[1] - span[0]) / 2 } : {};
      const found = await trend(position, fields, wide, base);
      if (!this.chosen.includes(entry)) return;
      this.trends.set(entry, found);
      this.troubles.delete(entry);
    } catch (error) {
      this.troubles.set(entry, /** @type {Error} */ (error).message);
    }
  }
}
