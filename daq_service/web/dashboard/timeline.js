// Convert hours of the test to UTC or local time, and place the ticks of an axis of dates.

import { instant, offsetMs } from "./format.js";

const HOUR_MS = 3_600_000;
const STEPS_H = [1 / 60, 1 / 12, 0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 96, 168, 336, 672, 1344, 2688, 5376, 10752];
const NARROWEST_PX = 84;

/** @typedef {"hours" | "utc" | "local"} Axis */

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

  /** @param {number} hour of the test @returns {string} date and time; empty on an axis of hours */
  text(hour) {
    return this.axis === "hours" ? "" : instant(Math.round(this.epochMs + hour * HOUR_MS));
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
    const offset = offsetMs(this.epochMs + from * HOUR_MS);
    let at = Math.ceil((this.epochMs + from * HOUR_MS - offset) / stepMs) * stepMs + offset;
    for (; at <= this.epochMs + to * HOUR_MS; at += stepMs) found.push((at - this.epochMs) / HOUR_MS);
    return found;
  }

  /** Return the time of day of each tick, with the date where a day starts. @param {number[]} splits */
  values(splits) {
    let shown = "";
    return splits.map((hour) => {
      const [date, time] = instant(Math.round(this.epochMs + hour * HOUR_MS)).split(" ");
      const text = date === shown ? time : `${time}\n${date}`;
      shown = date;
      return text;
    });
  }
}
