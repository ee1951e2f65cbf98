// Show a failed update, and the age of the data on the page.

import { el, setText } from "./dom.js";
import { duration } from "./format.js";
import { icon } from "./icons.js";

const TICK_MS = 1000;

export class UpdateFailure {
  /** @param {HTMLElement} root */
  constructor(root) {
    this.root = root;
    this.reason = el("strong");
    this.age = el("span");
    root.append(
      el("span", { class: "chip", "data-tone": "alarm" }, icon("link"), "Not updating"),
      el("p", {}, this.reason, " ", this.age),
    );
    this.readAt = 0;
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @param {Error} error @param {number} readAt time of the last complete update, by `performance.now()`; 0: never */
  fail(error, readAt) {
    this.readAt = readAt;
    setText(this.reason, `The last update failed: ${error.message}.`);
    this.root.hidden = false;
    this.tick();
  }

  clear() {
    this.root.hidden = true;
  }

  tick() {
    if (!this.root.hidden)
      setText(
        this.age,
        this.readAt
          ? `The data shown were read ${duration((performance.now() - this.readAt) / 1000)} ago.`
          : "Nothing has been read yet.",
      );
  }
}
