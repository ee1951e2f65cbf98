// Convert hours of the test to UTC or local time, and place the ticks of an axis of dates.

const HOUR_MS = 3_600_000;
const STEPS_H = [1 / 60, 1 / 12, 0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 96, 168, 336, 672, 1344, 2688, 5376, 10752];
const NARROWEST_PX = 84;

/** @typedef {"hours" | "utc" | "local"} Axis */

/** @param {number} value */
const two = (value) => String(value).padStart(2, "0");

export class Timeline {
  /** @param {Axis} axis @param {string} epochUtc RFC 3339 time of hour 0 */
  constructor(axis, epochUtc) {
    this.axis = axis;
    this.epochMs = Date.parse(epochUtc);
  }

  /** The label of the axis. */
  get label() {
    if (this.axis === "hours") return "Time since start (h)";
    return `Time (${this.axis === "utc" ? "UTC" : Intl.DateTimeFormat().resolvedOptions().timeZone})`;
  }

  /** @param {number} ms since 1970, of UTC @returns {[string, string]} date and time of day */
  parts(ms) {
    const at = new Date(ms - this.offsetMs(ms));
    return [
      `${at.getUTCFullYear()}-${two(at.getUTCMonth() + 1)}-${two(at.getUTCDate())}`,
      `${two(at.getUTCHours())}:${two(at.getUTCMinutes())}`,
    ];
  }

  /** UTC minus this axis's time. @param {number} ms */
  offsetMs(ms) {
    return this.axis === "local" ? new Date(ms).getTimezoneOffset() * 60_000 : 0;
  }

  /** @param {number} hour of the test @returns {string} date and time; empty on an axis of hours */
  text(hour) {
    if (this.axis === "hours") return "";
    return `${this.parts(this.epochMs + hour * HOUR_MS).join(" ")} ${this.axis === "utc" ? "UTC" : "local"}`;
  }

  /**
   * Return the hours of an axis of dates at which ticks lie: full days, hours or minutes.
   *
   * @param {number} from
   * @param {number} to
   * @param {number} widthPx
   */
  splits(from, to, widthPx) {
    const wanted = ((to - from) * NARROWEST_PX) / Math.max(widthPx, NARROWEST_PX);
    const stepMs = (STEPS_H.find((step) => step >= wanted) ?? STEPS_H[STEPS_H.length - 1]) * HOUR_MS;
    const found = [];
    const offset = this.offsetMs(this.epochMs + from * HOUR_MS);
    let at = Math.ceil((this.epochMs + from * HOUR_MS - offset) / stepMs) * stepMs + offset;
    for (; at <= this.epochMs + to * HOUR_MS; at += stepMs) found.push((at - this.epochMs) / HOUR_MS);
    return found;
  }

  /** Return the time of day of each tick, with the date where a day starts. @param {number[]} splits */
  values(splits) {
    let shown = "";
    return splits.map((hour) => {
      const [date, time] = this.parts(Math.round(this.epochMs + hour * HOUR_MS));
      const text = date === shown ? time : `${time}\n${date}`;
      shown = date;
      return text;
    });
  }
}
