// The limit beyond which a set is an outlier.

/** @param {any} verdict that of an earlier version has two limits, under names of their own @returns {number | null} */
export function limitOf(verdict) {
  const ofColumns = verdict.limit_name === "paper_mean_3sd" ? verdict.limit_paper : verdict.limit_f;
  return verdict.limits?.[verdict.limit_name] ?? ofColumns;
}
