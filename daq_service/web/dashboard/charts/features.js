// Label features for readers.

const NOT_MEASURED = new Set(["due_h", "age_h", "limit_f_predictive", "limit_mean_3sd"]);
/** Labels of features whose names alone are hard to read. @type {Record<string, string>} */
const LABELS = {
  tof_pp_s: "Time of flight, peak to peak",
  tof_ac_s: "Time of flight, autocorrelation",
  tof_mf_s: "Time of flight, matched filter",
  amplitude_ratio: "Amplitude ratio PSW / ISW",
  autocorrelation_coefficient: "Autocorrelation coefficient",
  psw_area_v_s: "Area of the PSW",
  psw_isw_area_ratio: "Area ratio PSW / ISW",
  isw_amplitude_v: "ISW amplitude",
  psw_amplitude_v: "PSW amplitude",
  ssw_amplitude_v: "SSW amplitude",
  isw_time_s: "ISW time",
  psw_time_s: "PSW time",
  ssw_time_s: "SSW time",
  isw_fwhm_s: "ISW width at half height",
  noise_rms_v: "Noise, rms",
  mewma_statistic: "Control chart (MEWMA)",
  distance_squared: "Mahalanobis squared distance",
  thickness_m: "Wall thickness",
  thickness_loss_m: "Wall loss",
  travel_time_s: "Travel time of the echo",
  correlation_coefficient: "Correlation with the reference echo",
};

/** @param {string} name of a column of /trends */
export const isFeature = (name) => !NOT_MEASURED.has(name);

/** @param {string} name of a column @returns {string} */
export const featureLabel = (name) => LABELS[name] ?? name;
