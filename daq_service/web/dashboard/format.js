// Format numbers and times. "–" stands for null of the API: not available.

/** @typedef {number | null | undefined} Maybe */

export const NONE = "–";

/**
 * @param {Maybe} value
 * @param {number} digits after the point
 */
export function fixed(value, digits) {
  return value === null || value === undefined || !Number.isFinite(value) ? NONE : value.toFixed(digits);
}

/**
 * @param {Maybe} value
 * @param {number} scale e.g. 1e6 for s to µs
 * @param {number} digits
 * @param {string} unit
 */
export function quantity(value, scale, digits, unit) {
  const text = fixed(value === null || value === undefined ? value : value * scale, digits);
  return text === NONE || !unit ? text : `${text} ${unit}`;
}

/** Format with three significant digits, without an exponent up to a million. @param {Maybe} value */
export function significant(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return scientific(value);
  return String(Number(value.toPrecision(3)));
}

/** Format in power-of-ten notation, e.g. 5.49 × 10⁻². @param {number} value */
export function scientific(value) {
  if (value === 0) return "0";
  const [mantissa, exponent] = value.toExponential(2).split("e");
  const power = Number(exponent);
  const superscript = [...String(power)].map((sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(sign)])).join("");
  return power === 0 ? mantissa : `${mantissa} × 10${superscript}`;
}

/** @param {number} seconds */
export function duration(seconds) {
  if (seconds < 1) return "< 1 s";
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 48 * 3600) return `${(seconds / 3600).toFixed(1)} h`;
  return `${(seconds / 86400).toFixed(1)} d`;
}

/** @param {Maybe} hours */
export function hour(hours) {
  return fixed(hours, 1);
}

/** @typedef {number | string} SetKey index of a scheduled set; "12.1" is the first unscheduled set after set 12 */

/** Return the key of the set of a row or an event. @param {any} row @returns {SetKey} */
export function setKey({ set_index, unscheduled_index }) {
  return unscheduled_index ? `${set_index}.${unscheduled_index}` : set_index;
}

/** Return the index of a scheduled set, or of the one before an unscheduled set. @param {SetKey} key */
export function scheduledIndex(key) {
  return parseInt(String(key), 10);
}

/** Return the name of a set in a sentence. @param {SetKey} key */
export function setName(key) {
  return typeof key === "string" ? `confirmation set ${key}` : `set ${key}`;
}

let local = false;

/** Choose the time zone of all times on the page: that of the computer, or UTC. @param {boolean} chosen */
export function setLocalTime(chosen) {
  local = chosen;
}

/** Return UTC minus the chosen time. @param {number} ms since 1970, of UTC */
export function offsetMs(ms) {
  return local ? new Date(ms).getTimezoneOffset() * 60_000 : 0;
}

/** Format an instant as "2026-11-26 13:05 UTC", or local with its offset. @param {number} ms since 1970, of UTC */
export function instant(ms) {
  const offset = -offsetMs(ms);
  const text = (/** @type {number} */ value) => new Date(value).toISOString();
  const zone = local ? `${offset < 0 ? "-" : "+"}${text(Math.abs(offset)).slice(11, 16)}` : "UTC";
  return `${text(ms + offset)
    .slice(0, 16)
    .replace("T", " ")} ${zone}`;
}

/** Format an RFC 3339 time in the chosen time zone. @param {string | null | undefined} text */
export function time(text) {
  return text ? instant(Date.parse(text)) : NONE;
}

/**
 * Return the age of the newest data of another test: on its own clock, and since its last update.
 *
 * @param {any} standing of /tests
 * @param {{data_h: Maybe, age_h: Maybe, stale: boolean}} data
 * @param {number} sinceS since the service read it
 */
export function ageText(standing, data, sinceS) {
  const wall = standing.wall_age_s === null ? NONE : `${duration(standing.wall_age_s + sinceS)} ago`;
  const elapsedH = standing.clock === "wall" ? sinceS / 3600 : 0;
  const last =
    data.data_h === null
      ? "no data yet"
      : `hour ${hour(data.data_h)} · ${fixed((data.age_h ?? 0) + elapsedH, 1)} h old`;
  return `${data.stale ? "Stale: " : ""}${last} · updated ${wall}`;
}

export { time as utc };
