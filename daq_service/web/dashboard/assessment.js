// Read an assessment: the limit above which a set is an outlier, and the diagnosis of a change.

/** @param {any} assessment of an earlier version: two limits with their own names @returns {number | null} */
export function limitOf(assessment) {
  const columnLimit =
    assessment.limit_name === "paper_mean_3sd" ? assessment.limit_mean_3sd : assessment.limit_f_predictive;
  return assessment.limits?.[assessment.limit_name] ?? columnLimit;
}

/**
 * Return the diagnosis of a change with its probability; an undetermined one has none.
 *
 * @param {any} assessment
 * @returns {string}
 */
export function diagnosisText(assessment) {
  const probability =
    assessment.diagnosis === "undetermined" ? "" : ` (${Math.round(100 * assessment.diagnosis_probability)} %)`;
  return `${assessment.diagnosis}${probability}`;
}
