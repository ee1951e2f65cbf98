// Read an assessment: the limit above which a set is an outlier, and the diagnosis of a change.

/** @param {any} assessment of an earlier version: two limits with their own names @returns {number | null} */
export function limitOf(assessment) {
  const columnLimit =
    assessment.limit_name === "paper_mean_3sd" ? assessment.limit_mean_3sd : assessment.limit_f_predictive;
  return assessment.limits?.[assessment.limit_name] ?? columnLimit;
}

/** Return a probability of the diagnosis model, rounded down, "< 1 %" to "> 99 %". @param {number} probability */
export function probabilityText(probability) {
  if (probability > 0.99) return "> 99 %";
  return probability < 0.01 ? "< 1 %" : `${Math.floor(100 * probability)} %`;
}

/**
 * Return the diagnosis of a change with its probability; an undetermined one has none.
 *
 * @param {any} assessment
 * @returns {string}
 */
export function diagnosisText(assessment) {
  const probability =
    assessment.diagnosis === "undetermined" ? "" : ` (${probabilityText(assessment.diagnosis_probability)})`;
  return `${assessment.diagnosis}${probability}`;
}
