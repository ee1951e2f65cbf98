// Keep the view of the page in its address: it survives a reload, can be sent, and the browser's
// "back" and "forward" step through it.

/**
 * @typedef {object} View
 * @property {string} position chosen tile; empty: the first
 * @property {string} charts position of the solitary-wave charts, where the chosen one has none; empty: the chosen one
 * @property {string[]} compare positions drawn over it; `TEST:POSITION` of another test of this service
 * @property {boolean} relative to each position's own baseline
 * @property {number | null} from_h null with `to_h`: the complete test
 * @property {number | null} to_h
 * @property {"hours" | "utc" | "local"} axis
 * @property {string} feature of the chart whose feature can be chosen
 * @property {import("./format.js").SetKey | null} set opened set of `position`
 * @property {number | null} shot emphasized shot of it
 * @property {number | null} from_us null with `to_us`: the full waveform
 * @property {number | null} to_us
 * @property {"trigger" | "first"} align where the waterfall's time counts from; first: the first pulse or echo
 * @property {"volts" | "normalised" | "difference"} shown by the waterfall
 * @property {number | null} from_wf_us null with `to_wf_us`: the full waveform of the waterfall
 * @property {number | null} to_wf_us
 * @property {string[]} hides overlays that the waterfall does not draw
 * @property {string[]} tables charts shown as tables, by id
 * @property {string} panel the one that an embedded page shows, by id
 * @property {boolean} embed only that panel is shown, and nothing is sent
 * @property {"" | "auto" | "light" | "dark"} theme empty: as this browser remembers
 */

/** @type {Readonly<View>} */
export const PLAIN = Object.freeze({
  position: "",
  charts: "",
  compare: [],
  relative: false,
  from_h: null,
  to_h: null,
  axis: "hours",
  feature: "tof_ac_s",
  set: null,
  shot: null,
  from_us: null,
  to_us: null,
  align: "trigger",
  shown: "volts",
  from_wf_us: null,
  to_wf_us: null,
  hides: [],
  tables: [],
  panel: "",
  embed: false,
  theme: "",
});
const CHOICES = /** @type {Record<string, string[]>} */ ({
  axis: ["hours", "utc", "local"],
  align: ["trigger", "first"],
  shown: ["volts", "normalised", "difference"],
  theme: ["auto", "light", "dark"],
});
const WHOLE_NUMBERS = new Set(["set", "shot"]);
const UNSCHEDULED_SET = /^\d{1,8}\.\d{1,3}$/;
const GESTURE_MS = 1000;

/** @param {string} key @param {string} text of the address @returns {unknown} undefined: not valid */
function read(key, text) {
  const plain = /** @type {any} */ (PLAIN)[key];
  if (Array.isArray(plain)) return [...new Set(text.split(",").filter(Boolean))];
  if (typeof plain === "boolean") return text === "1";
  if (key === "set" && UNSCHEDULED_SET.test(text)) return text;
  if (plain === null) {
    const value = text.trim() === "" ? NaN : Number(text);
    return Number.isFinite(value) && (!WHOLE_NUMBERS.has(key) || (Number.isSafeInteger(value) && value >= 0))
      ? value
      : undefined;
  }
  return CHOICES[key] && !CHOICES[key].includes(text) ? undefined : text;
}

/** @param {string} search the query of an address @returns {View} */
export function parse(search) {
  /** @type {any} */
  const view = { ...PLAIN };
  for (const [key, text] of new URLSearchParams(search)) {
    const value = Object.hasOwn(PLAIN, key) ? read(key, text) : undefined;
    if (value !== undefined) view[key] = value;
  }
  for (const [low, high] of [
    ["from_h", "to_h"],
    ["from_us", "to_us"],
    ["from_wf_us", "to_wf_us"],
  ]) {
    if (view[low] === null || view[high] === null || view[low] >= view[high]) view[low] = view[high] = null;
  }
  return view;
}

/** @param {View} view @returns {string} the query, without default values */
export function format(view) {
  const parts = [];
  for (const [key, value] of Object.entries(view)) {
    const plain = /** @type {any} */ (PLAIN)[key];
    if (String(value) === String(plain)) continue;
    // Commas and colons stay readable in an address that is sent.
    const text = encodeURIComponent(String(value)).replaceAll("%2C", ",").replaceAll("%3A", ":");
    parts.push(`${key}=${value === true ? "1" : text}`);
  }
  return parts.length ? `?${parts.join("&")}` : "";
}

export class Address {
  /** @param {(view: View, before: View) => void} onChange after every change, by this page or by the browser */
  constructor(onChange) {
    this.onChange = onChange;
    this.view = parse(location.search);
    this.gestureEnds = 0;
    addEventListener("popstate", () => this.become(parse(location.search)));
  }

  /** The shown hours; null: the complete test. @returns {[number, number] | null} */
  get span() {
    const { from_h, to_h } = this.view;
    return from_h === null || to_h === null ? null : [from_h, to_h];
  }

  /**
   * Go to another view.
   *
   * @param {Partial<View>} changes what changes
   * @param {{step?: boolean, gesture?: boolean}} [how] step: "back" skips the current view; gesture: the many
   *   changes of one turn of a wheel are one step back
   */
  go(changes, { step = false, gesture = false } = {}) {
    const view = { ...this.view, ...changes };
    const query = format(view);
    if (query === format(this.view)) return;
    const continues = gesture && performance.now() < this.gestureEnds;
    this.gestureEnds = gesture ? performance.now() + GESTURE_MS : 0;
    history[step || continues ? "replaceState" : "pushState"](null, "", `${location.pathname}${query}${location.hash}`);
    this.become(view);
  }

  /** @param {View} view */
  become(view) {
    const before = this.view;
    this.view = view;
    this.onChange(view, before);
  }
}
