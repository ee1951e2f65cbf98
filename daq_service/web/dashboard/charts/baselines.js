// Read the baselines of a position in order: the reference of each set's assessment and scale.

import { BASE, get, trend } from "../api.js";

/** Hours are sums of steps. */
const SAME_H = 1e-6;

/**
 * @typedef {object} Baseline
 * @property {number} from_h when its first set is due
 * @property {any} row of /baselines @property {any} trend all columns of its hours
 */

/**
 * Read a position's baselines; a probe has none, and its first hours serve as one.
 *
 * @param {string} position @param {string} method @param {number} baseline_h of the schedule
 * @param {Baseline[]} [previous] read before: unchanged ones are not read again @param {string} [base] of another test
 * @returns {Promise<Baseline[]>}
 */
export async function readBaselines(position, method, baseline_h, previous = [], base = BASE) {
  const rows =
    method === "pulse_echo"
      ? [{ from_h: 0, to_h: baseline_h, state: "collecting" }]
      : (await get(`/baselines?position=${position}`, base)).items;
  return Promise.all(
    rows.map(async (/** @type {any} */ row) => {
      const { from_h, to_h, name, state } = row;
      const same = previous.find(
        (baseline) => baseline.row.name === name && baseline.row.state === state && state !== "collecting",
      );
      return {
        from_h,
        row,
        trend:
          same?.trend ?? (await trend(position, undefined, { from_h: from_h - SAME_H, to_h: to_h + SAME_H }, base)),
      };
    }),
  );
}

/**
 * Return the baseline that a set belongs to or is assessed by.
 *
 * @template {{from_h: number}} T
 * @param {T[]} baselines
 * @param {number} hour
 * @returns {T | undefined}
 */
export const baselineAt = (baselines, hour) => baselines.findLast((baseline) => baseline.from_h <= hour + SAME_H);

/**
 * Return the hours in which each was recorded.
 *
 * @param {Baseline[]} baselines
 * @returns {import("./marks.js").Range[]}
 */
export function baselineRanges(baselines) {
  return baselines.map(({ from_h, row: { to_h } }, k) => ({
    from_h: k ? from_h : 0,
    // One that was retired while it collected ends where the next one starts.
    to_h: Math.min(to_h, baselines[k + 1]?.from_h ?? Infinity),
    label: baselines.length > 1 ? `baseline ${k + 1}` : "baseline",
    tone: "good",
  }));
}
