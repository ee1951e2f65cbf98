// What a verdict rests on: the limit beyond which a set is an outlier, and the cause of a change.

/** @param {any} verdict that of an earlier version has two limits, under names of their own @returns {number | null} */
export function limitOf(verdict) {
  const ofColumns = verdict.limit_name === "paper_mean_3sd" ? verdict.limit_paper : verdict.limit_f;
  return verdict.limits?.[verdict.limit_name] ?? ofColumns;
}

/** Cause of a change in words, with its probability; what cannot be told has none. @param {any} verdict @returns {string} */
export function causeOf(verdict) {
  const sure = verdict.cause === "cannot tell" ? "" : ` (${Math.round(100 * verdict.cause_probability)} %)`;
  return `${verdict.cause}${sure}`;
}
