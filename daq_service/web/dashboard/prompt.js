// What a person shall do now: a banner with the time that is left, gone when it is done or too late.

import { byId, setText } from "./dom.js";
import { duration } from "./format.js";
import { icon } from "./icons.js";

const TICK_MS = 250;

export class Asked {
  constructor() {
    this.banner = byId("asked");
    this.untilMs = 0;
    byId("asked-icon").append(icon("bell"));
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @param {any} event of the topic `service` */
  hear(event) {
    // Of an event that is told late `/info`, which is read after it, knows what is left.
    if (event.kind === "asked") this.show({ ...event.payload, left_s: event.payload.within_s });
    else if (["asked_over", "recorder_started", "recorder_stopped"].includes(event.kind)) this.show(null);
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
    if (this.banner.hidden !== leftS <= 0) this.banner.hidden = leftS <= 0;
    if (leftS > 0) setText(byId("asked-left"), duration(Math.ceil(leftS)));
  }
}
