// Convert columns of the API to chart lines: scaled, relative to the baseline, several positions on one axis.

import { baselineAt } from "./baselines.js";

/**
 * @typedef {object} Line
 * @property {string} key name in the read-only state
 * @property {string} label of the legend and the table
 * @property {string} short of the read-out
 * @property {string} color custom property
 * @property {(number | null)[]} y one entry per set of the chart's `x`
 * @property {boolean} points points with a thin line between them; else a line
 * @property {number} [shape] of its points
 * @property {number[]} [dash]
 * @property {string} [position] position of these sets
 * @property {(number | null)[]} [sets] set that each point opens; null: none
 * @property {(number | null)[]} [firstSets] first set of each
 * @property {number} [step] sets of each: above 1 they are bins
 * @property {(number | null)[]} [low] minimum of each bin
 * @property {(number | null)[]} [high] maximum of each bin
 * @property {(string | null)[]} [quality]
 * @property {(boolean | null)[]} [outlier]
 * @property {Forecast} [forecast]
 *
 * @typedef {object} Forecast two hours with the 5 %, 50 % and 95 % quantile at each, and the minimum
 * @property {number[]} hours @property {number[]} low @property {number[]} median @property {number[]} high
 * @property {number | null} minimum
 *
 * @typedef {(value: number, hour: number) => number | null} Scale
 */

/** Colors and shapes of further positions; with more positions only shapes distinguish them. */
const COLORS = ["--data", "--second", "--third", "--fourth"];

/** @param {number} index */
export const colorOf = (index) => COLORS[index % COLORS.length];

/** Displayed units: factor, name, digits. @type {Record<string, [number, string, number]>} */
const SHOWN = {
  s: [1e6, "µs", 3],
  m: [1e3, "mm", 3],
  v: [1, "V", 4],
  "V s": [1e6, "µV s", 3],
  V: [1, "V", 4],
  h: [1, "h", 2],
  1: [1, "", 4],
};

/** @param {string} unit of the API @returns {{factor: number, unit: string, digits: number}} */
export function shownUnit(unit) {
  const [factor, name, digits] = SHOWN[unit] ?? [1, unit, 4];
  return { factor, unit: name, digits };
}

/** @param {(number | null)[]} values @param {number[]} hours of each @param {Scale} scale */
export function scaleValues(values, hours, scale) {
  return values.map((value, k) => (value === null ? null : scale(value, hours[k])));
}

/**
 * Return the mean of the baseline's sets, the reference of "relative".
 *
 * @param {any} trend of the hours of the baseline @param {string} field
 * @returns {number | null} null: there is none yet
 */
export function baselineMean(trend, field) {
  const { columns, method } = trend;
  // A probe has no frozen baseline: each good measurement of these hours counts.
  const counts = (/** @type {unknown} */ _, /** @type {number} */ k) =>
    columns[field][k] !== null &&
    (method === "pulse_echo" ? columns.quality[k] === "good" : columns.in_baseline[k] === true);
  const values = columns[field].filter(counts);
  return values.length
    ? values.reduce((/** @type {number} */ sum, /** @type {number} */ value) => sum + value, 0) / values.length
    : null;
}

/**
 * Return a scale in percent relative to the baseline in force; null without one.
 *
 * @param {import("./baselines.js").Baseline[]} baselines
 * @param {string} field
 * @returns {Scale}
 */
export function relativeTo(baselines, field) {
  const means = baselines.map((baseline) => ({ from_h: baseline.from_h, mean: baselineMean(baseline.trend, field) }));
  return (value, hour) => {
    const mean = baselineAt(means, hour)?.mean;
    return mean ? 100 * (value / mean - 1) : null;
  };
}

/**
 * Merge the hours of several positions into one axis.
 *
 * @param {number[][]} hours of each position
 * @returns {{x: number[], rows: (number[] | null)[]}} rows: per position the row of each x, -1 for none; null:
 *   unchanged
 */
export function mergeHours(hours) {
  const [first, ...others] = hours;
  if (others.every((one) => one.length === first.length && one.every((hour, k) => hour === first[k])))
    return { x: first, rows: hours.map(() => null) };
  const x = [...new Set(hours.flat())].sort((a, b) => a - b);
  return {
    x,
    rows: hours.map((positionHours) => {
      const rowOf = new Map(positionHours.map((hour, row) => [hour, row]));
      return x.map((hour) => rowOf.get(hour) ?? -1);
    }),
  };
}

/** @template T @param {T[]} column @param {number[] | null} rows @returns {(T | null)[]} */
export function onAxis(column, rows) {
  return rows === null ? column : rows.map((row) => (row < 0 ? null : column[row]));
}

/**
 * Return whether a set is missing between two points of a line.
 *
 * @param {Line} line
 * @param {number} a
 * @param {number} b rows
 */
export function missing({ firstSets, step }, a, b) {
  const [before, after] = [firstSets?.[a], firstSets?.[b]];
  return (
    before !== null && before !== undefined && after !== null && after !== undefined && after > before + (step ?? 1)
  );
}

/** @param {any} fit of /fits @param {number[]} x @param {Scale} scale */
export function fitLine(fit, x, scale) {
  if (!fit?.coefficients) return x.map(() => null);
  const [c0, c1, c2] = fit.coefficients;
  return x.map((t) => (t >= fit.from_h && t <= fit.to_h ? scale(c0 + (c1 + c2 * t) * t, t) : null));
}
