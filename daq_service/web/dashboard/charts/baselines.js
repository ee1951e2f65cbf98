// Baselines of a position in the order of their lives: what judges a set, and what it is relative to.

import { BASE, get, trend } from "../api.js";

/** Hours are sums of steps. */
const SAME_H = 1e-6;

/**
 * @typedef {object} Life
 * @property {number} from_h when its first set is due
 * @property {any} row of /baselines @property {any} trend all columns of its hours
 */

/**
 * Read a position's baselines; a probe has none, and the first hours stand for one.
 *
 * @param {string} position @param {string} method @param {number} baseline_h of the schedule
 * @param {Life[]} [known] as read before: what has not changed since is not read again @param {string} [base] of another test
 * @returns {Promise<Life[]>}
 */
export async function livesOf(position, method, baseline_h, known = [], base = BASE) {
  const rows = method === "pulse_echo" ? [{ from_h: 0, to_h: baseline_h, state: "collecting" }] : (await get(`/baselines?position=${position}`, base)).items;
  return Promise.all(
    rows.map(async (/** @type {any} */ row) => {
      const { from_h, to_h, name, state } = row;
      const same = known.find((life) => life.row.name === name && life.row.state === state && state !== "collecting");
      return { from_h, row, trend: same?.trend ?? (await trend(position, undefined, { from_h: from_h - SAME_H, to_h: to_h + SAME_H }, base)) };
    }),
  );
}

/** The one that a set belongs to or is judged by. @template {{from_h: number}} T @param {T[]} lives @param {number} hour @returns {T | undefined} */
export const inForce = (lives, hour) => lives.findLast((life) => life.from_h <= hour + SAME_H);

/** Hours in which each was recorded. @param {Life[]} lives @returns {import("./marks.js").Range[]} */
export function bandsOf(lives) {
  return lives.map(({ from_h, row: { to_h } }, k) => ({
    from_h: k ? from_h : 0,
    // One that was retired while it collected ends where the next begins.
    to_h: Math.min(to_h, lives[k + 1]?.from_h ?? Infinity),
    word: lives.length > 1 ? `baseline ${k + 1}` : "baseline",
    tone: "good",
  }));
}
