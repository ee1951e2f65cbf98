// Hold and release: a button that asks why, and a banner for as long as nothing strikes.

import { confirmed } from "./control/confirm.js";
import { may } from "./control/session.js";
import { byId, setText } from "./dom.js";
import { icon } from "./icons.js";
import { giveBy } from "./commands.js";

export class Hold {
  /** @param {(text: string) => void} onTrouble */
  constructor(onTrouble) {
    this.onTrouble = onTrouble;
    this.button = /** @type {HTMLButtonElement} */ (byId("hold"));
    this.banner = byId("held");
    this.releaseButton = /** @type {HTMLButtonElement} */ (byId("release"));
    byId("held-icon").append(icon("pause"));
    this.button.addEventListener("click", () => void this.hold());
    this.releaseButton.addEventListener("click", () => void this.release());
  }

  /** @param {string | null} held who holds the test and why @param {string} recorder */
  update(held, recorder) {
    const listens = recorder !== "finished" && recorder !== "stopped";
    this.banner.hidden = held === null;
    this.button.hidden = held !== null || !listens || !may("hold");
    this.releaseButton.hidden = !listens || !may("release");
    setText(byId("held-why"), held === null ? "" : `${held[0].toUpperCase()}${held.slice(1)}`);
  }

  async hold() {
    const given = await confirmed({
      title: "Hold the test",
      says: ["The strike that is under way ends, none follows, and a restart does not end the hold."],
      word: "Hold now",
      // A hold is the safe choice itself: what it needs has the focus.
      fields: [{ name: "note", label: "Reason", first: true, input: { required: true, pattern: ".*\\S.*", placeholder: "hands in the rig" } }],
    });
    if (given) await giveBy(this.button, "hold", given, this.onTrouble);
  }

  async release() {
    const given = await confirmed({
      title: "Release the test",
      says: ["Strikers move again from the next due set on: hands out of the rig, doors shut.", "To take it back, hold the test again."],
      word: "Release now",
    });
    if (given) await giveBy(this.releaseButton, "release", {}, this.onTrouble);
  }
}
