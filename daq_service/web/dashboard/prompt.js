// Ask the operator to act: a banner with the remaining time, hidden when it is done or too late.

import { byId, setText } from "./dom.js";
import { duration, setKey, setName } from "./format.js";
import { icon } from "./icons.js";

const TICK_MS = 250;

export class OperatorPrompt {
  constructor() {
    this.banner = byId("prompt");
    this.deadlineMs = 0;
    byId("prompt-icon").append(icon("bell"));
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @param {any} event of the topic `service` */
  onEvent(event) {
    // For an event that arrives late, `/info`, which is read after it, has the remaining time.
    if (event.kind === "asked") this.show({ ...event.payload, left_s: event.payload.within_s });
    else if (["asked_over", "recorder_started", "recorder_stopped"].includes(event.kind)) this.show(null);
  }

  /** @param {any} request from `/info`; null: no action is needed */
  show(request) {
    this.deadlineMs = request === null ? 0 : performance.now() + 1000 * request.left_s;
    if (request !== null) {
      setText(byId("prompt-text"), request.text);
      const shotText =
        request.position == null
          ? ""
          : `Position ${request.position}, ${setName(setKey(request))}, shot ${request.shot_index}`;
      setText(byId("prompt-shot"), request.attempt ? `${shotText}, repeat` : shotText);
    }
    this.tick();
  }

  tick() {
    const remainingS = (this.deadlineMs - performance.now()) / 1000;
    if (this.banner.hidden !== remainingS <= 0) this.banner.hidden = remainingS <= 0;
    if (remainingS > 0) setText(byId("prompt-remaining"), duration(Math.ceil(remainingS)));
  }
}
