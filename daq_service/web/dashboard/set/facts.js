// Show a set in numbers: features and their contribution to D², single shots, climate and provenance.

import { el } from "../dom.js";
import { isFeature, featureLabel } from "../charts/features.js";
import { shownUnit } from "../charts/series.js";
import { diagnosisText, limitOf } from "../assessment.js";
import { NONE, fixed, hour, quantity, significant, time } from "../format.js";

/** @typedef {import("./data.js").SetData} SetData */

/** @param {string} name @param {number | null | undefined} value @param {Record<string, string>} units of /trends */
function shown(name, value, units) {
  const { factor, unit, digits } = shownUnit(units[name] ?? "1");
  return quantity(value, factor, digits, unit);
}

/** @param {string} title @param {...Element} contributions */
function section(title, ...contributions) {
  return el("section", { class: "fact" }, el("h3", { text: title }), ...contributions);
}

/** @param {[string, string][]} values */
function list(values) {
  return el(
    "dl",
    { class: "readouts" },
    ...values.map(([name, value]) => el("div", {}, el("dt", { text: name }), el("dd", { text: value }))),
  );
}

/** @param {string} caption @param {string[]} head @param {HTMLElement[]} rows */
function table(caption, head, rows) {
  const wrap = el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": caption });
  wrap.append(
    el(
      "table",
      {},
      el("caption", { text: caption }),
      el("thead", {}, el("tr", {}, ...head.map((text) => el("th", { scope: "col", text })))),
      el("tbody", {}, ...rows),
    ),
  );
  return wrap;
}

/** @param {number | null} share of the total, by magnitude @param {string} text */
function bar(share, text) {
  const filled = el("span", { class: "bar", "aria-hidden": "true" });
  filled.style.width = `${100 * Math.min(1, Math.abs(share ?? 0))}%`;
  return el("td", { class: "share" }, filled, el("span", { text }));
}

/** @param {SetData} data @param {Record<string, string>} units */
export function features({ feature, assessment }, units) {
  if (feature === null)
    return section("Features", el("p", { class: "quiet small", text: "No feature: too few valid shots." }));
  const contributions = assessment?.contributions ?? {};
  const total = Object.values(contributions).reduce((sum, value) => sum + Math.abs(value ?? 0), 0);
  const rows = Object.keys(units)
    .filter((name) => isFeature(name) && name in feature)
    .map((name) => {
      const value = contributions[name];
      const known = value !== undefined && value !== null;
      return el(
        "tr",
        {},
        el("td", { text: featureLabel(name) }),
        el("td", { text: shown(name, feature[name], units) }),
        known ? bar(total ? value / total : 0, significant(value)) : el("td", { text: "" }),
      );
    });
  const caption =
    `${feature.n_valid === undefined ? "One waveform" : `Mean of ${feature.n_valid} valid shots`}, ` +
    `quality ${feature.quality}; the last column is each feature's contribution to D²`;
  return section("Features", table(caption, ["Feature", "Value", "Contribution to D²"], rows));
}

/** @param {SetData} data @param {any} limits of /info */
export function distance({ assessment }, limits) {
  if (assessment === null) return section("Distance", el("p", { class: "quiet small", text: "Not assessed." }));
  const { diagnosis_details: diagnosis } = assessment;
  const limit = limitOf(assessment);
  const limitNames = /** @type {Record<string, string>} */ ({
    paper_mean_3sd: "mean + 3 SD",
    f_predictive: `F limit, ${significant(100 * limits.false_alarm_rate)} % false alarms`,
  });
  const limitName = limitNames[assessment.limit_name] ?? assessment.limit_name;
  const result = assessment.in_baseline
    ? "part of the baseline"
    : assessment.outlier === null
      ? (assessment.reason ?? "not assessed")
      : assessment.outlier
        ? "above the limit: outlier"
        : "below the limit";
  return section(
    "Distance",
    list([
      ["D²", significant(assessment.distance_squared)],
      ["Limit of outliers", `${significant(limit)} (${limitName})`],
      [
        "Ratio to limit",
        limit && assessment.distance_squared !== null
          ? Number((assessment.distance_squared / limit).toPrecision(2)).toString()
          : NONE,
      ],
      ["Result", result],
      .../** @type {[string, string][]} */ (
        assessment.diagnosis
          ? [
              ["Diagnosis", diagnosisText(assessment)],
              ["Observation", diagnosis.sentence],
              ["What to do", diagnosis.action],
            ]
          : []
      ),
    ]),
    ...(assessment.limits ? [limitTable(assessment, limits.named)] : []),
  );
}

/**
 * List all limits of the service with the values that they bound.
 *
 * @param {any} assessment
 * @param {any[]} limits of /info
 */
function limitTable(assessment, limits) {
  /** @type {Record<string, number | null>} */
  const values = {
    ...assessment.statistics,
    distance_squared: assessment.distance_squared,
    mewma_statistic: assessment.mewma_statistic,
  };
  const rows = limits
    .filter(({ name }) => name in assessment.limits)
    .map(({ name, description, of }) => {
      const value = values[of] ?? null;
      const limit = assessment.limits[name];
      return el(
        "tr",
        {},
        el("td", { text: name, title: description }),
        el("td", { text: significant(limit) }),
        el("td", { text: significant(value) }),
        el("td", { text: value === null ? NONE : value > limit ? "above" : "below" }),
      );
    });
  return table("Limits", ["Name", "Limit", "Value", "Result"], rows);
}

/**
 * @param {SetData} data @param {Record<string, string>} units
 * @param {number | null} chosen @param {(shot: number | null) => void} choose
 */
export function shots({ shots: rows, shotFeatures }, units, chosen, choose) {
  if (!rows.length) return null;
  const featureOf = new Map(shotFeatures.map((one) => [one.sequence, one]));
  const columns = ["tof_pp_s", "amplitude_ratio", "isw_amplitude_v"].filter((name) => name in units);
  const cells = rows.map((shot) => {
    const found = featureOf.get(shot.sequence);
    const accepted = shot.outcome === "accepted";
    const pressed = accepted && chosen === shot.shot_index;
    const button = el("button", {
      class: "link",
      type: "button",
      disabled: !accepted,
      "aria-pressed": String(pressed),
      "data-shot": String(shot.shot_index),
      text: `${shot.shot_index}${shot.attempt ? `, repetition ${shot.attempt}` : ""}`,
    });
    button.addEventListener("click", () => choose(pressed ? null : shot.shot_index));
    const row = el(
      "tr",
      {},
      el("td", {}, button),
      el("td", { text: `${found?.quality ?? (shot.valid ? "valid" : "not valid")}${accepted ? "" : ", repeated"}` }),
      el("td", { text: shot.flags.join(", ") || "none" }),
    );
    for (const name of columns) row.append(el("td", { text: shown(name, found?.[name], units) }));
    row.append(el("td", { text: String(shot.sequence) }));
    return row;
  });
  return section(
    "Shots",
    table(
      "Select a shot to emphasize its waveform",
      ["Shot", "Quality", "Flags", ...columns.map(featureLabel), "Sequence"],
      cells,
    ),
  );
}

/** @param {SetData} data */
export function climate({ environment: row }) {
  if (row === null)
    return section("Climate and supply", el("p", { class: "quiet small", text: "No reading around this set." }));
  const age = (/** @type {string} */ quality, /** @type {number | null} */ age_s) =>
    quality === "absent" ? "absent" : `${quality}${age_s === null ? "" : `, read ${fixed(age_s, 0)} s before`}`;
  return section(
    "Climate and supply",
    list([
      ["Temperature", quantity(row.temperature_c, 1, 1, "°C")],
      ["Relative humidity", quantity(row.relative_humidity, 100, 0, "%")],
      ["Climate probe", age(row.climate_quality, row.climate_age_s)],
      ["Supply", `${row.supply_state}, ${age(row.supply_quality, row.supply_age_s)}`],
      ["Voltage", quantity(row.voltage_v, 1, 2, "V")],
      ["Current", quantity(row.current_a, 1e3, 2, "mA")],
    ]),
  );
}

/** @param {SetData} data @param {any} info */
export function provenance({ set, feature, assessment, baseline }, info) {
  if (set === null) return null;
  const sets = baseline && `sets ${baseline.first_set_index} to ${baseline.last_set_index}`;
  const baselineText = baseline && ` (${baseline.name}, ${sets}, approval ${baseline.approval})`;
  const identity = Object.entries(info.rig_identity).map(([name, value]) => `${name} ${value}`);
  const serial = info.positions.find(
    (/** @type {any} */ positionInfo) => positionInfo.position === set.position,
  )?.serial_number;
  return section(
    "Provenance",
    list([
      ["File", set.file ?? NONE],
      ["SHA-256", set.file_sha256 ? `${set.file_sha256.slice(0, 16)}…` : NONE],
      ["Recorded", `${time(set.started_utc)} to ${time(set.ended_utc)}`],
      ["Age", `${hour(set.age_h)} h`],
      [
        "Shots",
        `${set.n_valid} valid of ${set.n_taken} taken, ${set.n_planned} planned` +
          (set.n_restrikes ? `, ${set.n_restrikes} repeated` : ""),
      ],
      ["Rig", [info.rig_label, ...identity].join(", ")],
      ["Transducer", serial ?? NONE],
      ["Extractor", feature?.extractor_version ?? NONE],
      ["Baseline", assessment?.baseline_id == null ? NONE : `${assessment.baseline_id}${baselineText ?? ""}`],
      ["Configuration", info.configuration_hash.slice(0, 16)],
    ]),
  );
}
