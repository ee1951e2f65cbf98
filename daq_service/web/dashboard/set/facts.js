// What a set says in numbers: features and their share of D², single shots, climate, and where it all comes from.

import { el } from "../dom.js";
import { isFeature, wordOf } from "../charts/features.js";
import { shownUnit } from "../charts/series.js";
import { causeOf, limitOf } from "../assessment.js";
import { NONE, fixed, hour, quantity, significant, utc } from "../format.js";

/** @typedef {import("./data.js").Evidence} Evidence */

/** @param {string} name @param {number | null | undefined} value @param {Record<string, string>} units of /trends */
function shown(name, value, units) {
  const { factor, unit, digits } = shownUnit(units[name] ?? "1");
  return quantity(value, factor, digits, unit);
}

/** @param {string} title @param {...Element} parts */
function part(title, ...parts) {
  return el("section", { class: "fact" }, el("h3", { text: title }), ...parts);
}

/** @param {[string, string][]} values */
function list(values) {
  return el("dl", { class: "readouts" }, ...values.map(([name, value]) => el("div", {}, el("dt", { text: name }), el("dd", { text: value }))));
}

/** @param {string} caption @param {string[]} head @param {HTMLElement[]} rows */
function table(caption, head, rows) {
  const wrap = el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": caption });
  wrap.append(el("table", {}, el("caption", { text: caption }), el("thead", {}, el("tr", {}, ...head.map((text) => el("th", { scope: "col", text })))), el("tbody", {}, ...rows)));
  return wrap;
}

/** @param {number | null} share of the whole, by size @param {string} text */
function bar(share, text) {
  const filled = el("span", { class: "bar", "aria-hidden": "true" });
  filled.style.width = `${100 * Math.min(1, Math.abs(share ?? 0))}%`;
  return el("td", { class: "share" }, filled, el("span", { text }));
}

/** @param {Evidence} evidence @param {Record<string, string>} units */
export function features({ feature, verdict }, units) {
  if (feature === null) return part("Features", el("p", { class: "quiet small", text: "No feature: the set gave too few valid records." }));
  const parts = verdict?.contributions ?? {};
  const all = Object.values(parts).reduce((sum, value) => sum + Math.abs(value ?? 0), 0);
  const rows = Object.keys(units)
    .filter((name) => isFeature(name) && name in feature)
    .map((name) => {
      const value = parts[name];
      const given = value !== undefined && value !== null;
      return el("tr", {}, el("td", { text: wordOf(name) }), el("td", { text: shown(name, feature[name], units) }), given ? bar(all ? value / all : 0, significant(value)) : el("td", { text: "" }));
    });
  const caption = `${feature.n_valid === undefined ? "Of the record" : `Mean of ${feature.n_valid} valid shots`}, quality ${feature.quality}; the last column is each feature's part of D²`;
  return part("Features", table(caption, ["Feature", "Value", "Part of D²"], rows));
}

/** @param {Evidence} evidence @param {any} limits of /info */
export function distance({ verdict }, limits) {
  if (verdict === null) return part("Distance", el("p", { class: "quiet small", text: "Not judged." }));
  const limit = limitOf(verdict);
  const word = verdict.in_baseline ? "part of the baseline" : verdict.outlier === null ? (verdict.reason ?? "not judged") : verdict.outlier ? "beyond the limit: outlier" : "within the limit";
  return part(
    "Distance",
    list([
      ["D²", significant(verdict.distance_squared)],
      ["Limit of outliers", `${significant(limit)} (${verdict.limit_name === "paper_mean_3sd" ? "paper's mean + 3 SD" : verdict.limit_name === "f_predictive" ? `predictive F, ${significant(100 * limits.false_alarm_rate)} % false alarms` : verdict.limit_name})`],
      ["Times the limit", limit && verdict.distance_squared !== null ? significant(verdict.distance_squared / limit) : NONE],
      ["Verdict", word],
      .../** @type {[string, string][]} */ (verdict.cause ? [["Cause", causeOf(verdict)], ["What is seen", verdict.cause_told.sentence], ["What to do", verdict.cause_told.action]] : []),
    ]),
    ...(verdict.limits ? [named(verdict, limits.named)] : []),
  );
}

/** Every limit that the service has, beside what it bounds. @param {any} verdict @param {any[]} all of /info */
function named(verdict, all) {
  /** @type {Record<string, number | null>} */
  const values = { ...verdict.statistics, distance_squared: verdict.distance_squared, chart: verdict.chart };
  const rows = all
    .filter(({ name }) => name in verdict.limits)
    .map(({ name, words, of }) => {
      const value = values[of] ?? null;
      const limit = verdict.limits[name];
      return el("tr", {}, el("td", { text: name, title: words }), el("td", { text: significant(limit) }), el("td", { text: significant(value) }), el("td", { text: value === null ? NONE : value > limit ? "beyond" : "within" }));
    });
  return table("Every limit, and what it bounds", ["Limit", "Its value", "The set's", "Verdict"], rows);
}

/**
 * @param {Evidence} evidence @param {Record<string, string>} units
 * @param {number | null} chosen @param {(shot: number | null) => void} choose
 */
export function shots({ shots: all, ofShots }, units, chosen, choose) {
  if (!all.length) return null;
  const featureOf = new Map(ofShots.map((one) => [one.sequence, one]));
  const columns = ["tof_pp_s", "amplitude_ratio", "isw_amplitude_v"].filter((name) => name in units);
  const rows = all.map((shot) => {
    const found = featureOf.get(shot.sequence);
    const accepted = shot.outcome === "accepted";
    const pressed = accepted && chosen === shot.shot_index;
    const button = el("button", { class: "link", type: "button", disabled: !accepted, "aria-pressed": String(pressed), "data-shot": String(shot.shot_index), text: `${shot.shot_index + 1}${shot.attempt ? `, attempt ${shot.attempt + 1}` : ""}` });
    button.addEventListener("click", () => choose(pressed ? null : shot.shot_index));
    const row = el("tr", {}, el("td", {}, button), el("td", { text: `${found?.quality ?? (shot.valid ? "valid" : "not valid")}${accepted ? "" : ", repeated"}` }), el("td", { text: shot.flags.join(", ") || "none" }));
    for (const name of columns) row.append(el("td", { text: shown(name, found?.[name], units) }));
    row.append(el("td", { text: String(shot.sequence) }));
    return row;
  });
  return part("Shots", table("A shot's number emphasises its record", ["Shot", "Quality", "Flags", ...columns.map(wordOf), "Sequence"], rows));
}

/** @param {Evidence} evidence */
export function climate({ environment: row }) {
  if (row === null) return part("Climate and supply", el("p", { class: "quiet small", text: "Nothing was read around this set." }));
  const age = (/** @type {string} */ quality, /** @type {number | null} */ age_s) => (quality === "absent" ? "absent" : `${quality}${age_s === null ? "" : `, read ${fixed(age_s, 0)} s before`}`);
  return part(
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

/** @param {Evidence} evidence @param {any} info */
export function provenance({ set, feature, verdict, baseline }, info) {
  if (set === null) return null;
  const identity = Object.entries(info.rig_identity).map(([name, value]) => `${name} ${value}`);
  const serial = info.positions.find((/** @type {any} */ place) => place.position === set.position)?.serial_number;
  return part(
    "Provenance",
    list([
      ["File", set.file ?? NONE],
      ["Its SHA-256", set.file_sha256 ? `${set.file_sha256.slice(0, 16)}…` : NONE],
      ["Recorded", `${utc(set.started_utc)} to ${utc(set.ended_utc)}`],
      ["Age", `${hour(set.age_h)} h`],
      ["Records", `${set.n_valid} valid of ${set.n_taken} taken, ${set.n_planned} planned${set.n_restrikes ? `, ${set.n_restrikes} repeated` : ""}`],
      ["Rig", [info.rig_label, ...identity].join(", ")],
      ["Transducer", serial ?? NONE],
      ["Extractor", feature?.extractor_version ?? NONE],
      ["Baseline", verdict?.baseline_id == null ? NONE : `${verdict.baseline_id}${baseline ? ` (${baseline.name}, sets ${baseline.first_set_index} to ${baseline.last_set_index}, approval ${baseline.approval})` : ""}`],
      ["Configuration", info.configuration_hash.slice(0, 16)],
    ]),
  );
}
