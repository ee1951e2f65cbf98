// Read series of other tests of this service, in hours since hour 0 of each; the address names them.

import { BASE, get, trend } from "../api.js";
import { FIELDS } from "../data-loader.js";
import { readBaselines } from "./baselines.js";

const REFRESH_MS = 5000;

/** @typedef {{test: string, position: string}} TestPosition */

/** Entries of `compare` are positions of this test, or `TEST:POSITION` of another. @param {string} entry */
export const isOther = (entry) => entry.includes(":");

/** @param {string} entry @returns {TestPosition} */
export function parseEntry(entry) {
  const [test, position] = entry.split(":");
  return { test, position };
}

/** Return the name of an entry for the legend. @param {string} entry */
export const nameOf = (entry) => entry.replace(":", " ");

/** Return the base path of a test for `api.js`. @param {string} test */
const baseOf = (test) => `/tests/${encodeURIComponent(test)}`;

export class OtherTests {
  /** @param {() => void} onChange lists or series are new */
  constructor(onChange) {
    this.onChange = onChange;
    /** @type {any[]} the other tests, as the service lists them */
    this.items = [];
    /** When they were read, by `performance.now()`. */
    this.readAt = 0;
    /** @type {Map<string, any>} columns by entry */
    this.trends = new Map();
    /** Baselines by entry, the current one last. @type {Map<string, import("./baselines.js").Baseline[]>} */
    this.baselines = new Map();
    /** @type {Map<string, string>} reason why an entry is not drawn */
    this.errors = new Map();
    /** @type {string[]} */
    this.chosen = [];
    this.feature = "";
    /** @type {[number, number] | null} */
    this.span = null;
    this.requested = "";
    this.isLoading = false;
  }

  /** @param {import("../view.js").View} view */
  choose(view) {
    if (BASE === "") return;
    this.chosen = view.compare.filter(isOther);
    this.feature = view.feature;
    this.span = view.from_h === null || view.to_h === null ? null : [view.from_h, view.to_h];
    const requested = JSON.stringify([this.chosen, this.feature, this.chosen.length ? this.span : null]);
    if (requested === this.requested) return;
    const first = this.requested === "";
    this.requested = requested;
    for (const one of [...this.trends.keys()]) if (!this.chosen.includes(one)) this.forget(one);
    if (first) void this.poll();
    else void this.read();
  }

  /** @param {string} entry */
  forget(entry) {
    for (const kept of [this.trends, this.baselines, this.errors]) kept.delete(entry);
  }

  /** @param {string} entry @returns {any} its test in the service's list */
  testOf(entry) {
    return this.items.find((item) => item.test === parseEntry(entry).test);
  }

  /** @param {string} entry @returns {any} state of its position */
  positionInfo(entry) {
    return this.testOf(entry)?.standing?.positions.find(
      (/** @type {any} */ positionInfo) => positionInfo.position === parseEntry(entry).position,
    );
  }

  /** Read regularly, each time after the last answers. */
  async poll() {
    if (!document.hidden) await this.read();
    setTimeout(() => this.poll(), REFRESH_MS);
  }

  async read() {
    if (this.isLoading) return;
    this.isLoading = true;
    const { requested } = this;
    try {
      const { items } = await get("/tests", "");
      this.items = items.filter((/** @type {any} */ item) => item.page !== `${BASE}/`);
      this.readAt = performance.now();
      await Promise.all(this.chosen.map((entry) => this.readOne(entry)));
    } catch (error) {
      for (const entry of this.chosen) this.errors.set(entry, /** @type {Error} */ (error).message);
    }
    this.isLoading = false;
    this.onChange();
    if (requested !== this.requested) void this.read();
  }

  /** @param {string} entry */
  async readOne(entry) {
    const { test, position } = parseEntry(entry);
    const positionInfo = this.positionInfo(entry);
    if (!positionInfo) {
      this.errors.set(entry, this.testOf(entry)?.detail ?? `this service has no ${nameOf(entry)}`);
      this.trends.delete(entry);
      return;
    }
    try {
      const base = baseOf(test);
      const { schedule } = await get("/info", base);
      const baselines = await readBaselines(
        position,
        positionInfo.method,
        schedule.baseline_h,
        this.baselines.get(entry),
        base,
      );
      this.baselines.set(entry, baselines);
      const fields = [...FIELDS[positionInfo.method]];
      if (this.feature in baselines[baselines.length - 1].trend.columns && !fields.includes(this.feature))
        fields.push(this.feature);
      const { span } = this;
      const wide = span
        ? { from_h: Math.max(0, span[0] - (span[1] - span[0]) / 2), to_h: span[1] + (span[1] - span[0]) / 2 }
        : {};
      const found = await trend(position, fields, wide, base);
      if (!this.chosen.includes(entry)) return;
      this.trends.set(entry, found);
      this.errors.delete(entry);
    } catch (error) {
      this.errors.set(entry, /** @type {Error} */ (error).message);
    }
  }
}
