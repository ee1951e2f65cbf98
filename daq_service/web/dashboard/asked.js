// What a person shall do now: a banner with the time that is left, gone when it is done or too late.

import { byId, setText } from "./dom.js";
import { duration } from "./format.js";
import { icon } from "./icons.js";

const TICK_MS = 250;
/** An event that is older was told before this page listened; less is the way it took and clocks apart. */
const OLD_S = 2;

export class Asked {
  constructor() {
    this.banner = byId("asked");
    this.untilMs = 0;
    byId("asked-icon").append(icon("bell"));
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @param {any} event of the topic `service` */
  hear(event) {
    if (event.kind === "asked") {
      const ageS = (Date.now() - Date.parse(event.utc)) / 1000;
      this.show({ ...event.payload, left_s: event.payload.within_s - (ageS > OLD_S ? ageS : 0) });
    } else if (["asked_over", "recorder_started", "recorder_stopped"].includes(event.kind)) this.show(null);
  }

  /** @param {any} asked as `/info` tells it; null: nothing */
  show(asked) {
    this.untilMs = asked === null ? 0 : performance.now() + 1000 * asked.left_s;
    if (asked !== null) {
      setText(byId("asked-text"), asked.text);
      const which = asked.position == null ? "" : `Position ${asked.position}, set ${asked.set_index + 1}, shot ${asked.shot_index + 1}`;
      setText(byId("asked-shot"), asked.attempt ? `${which}, once more` : which);
    }
    this.tick();
  }

  tick() {
    const leftS = (this.untilMs - performance.now()) / 1000;
    this.banner.hidden = leftS <= 0;
    if (leftS > 0) setText(byId("asked-left"), duration(Math.ceil(leftS)));
  }
}
