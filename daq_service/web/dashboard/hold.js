// Hold and release: a button that asks why, and a banner for as long as nothing strikes.

import { byId, setText } from "./dom.js";
import { icon } from "./icons.js";
import { order } from "./orders.js";

export class Hold {
  /** @param {(text: string) => void} onTrouble */
  constructor(onTrouble) {
    this.onTrouble = onTrouble;
    this.button = /** @type {HTMLButtonElement} */ (byId("hold"));
    this.dialog = /** @type {HTMLDialogElement} */ (byId("hold-dialog"));
    this.reason = /** @type {HTMLInputElement} */ (byId("hold-reason"));
    this.banner = byId("held");
    this.releaseButton = /** @type {HTMLButtonElement} */ (byId("release"));
    byId("held-icon").append(icon("pause"));
    this.button.addEventListener("click", () => this.ask());
    byId("hold-cancel").addEventListener("click", () => this.dialog.close());
    byId("hold-confirm").addEventListener("click", () => this.hold());
    this.reason.addEventListener("keydown", (event) => event.key === "Enter" && this.hold());
    this.releaseButton.addEventListener("click", () => this.give("release", this.releaseButton, "Release", {}));
  }

  /** @param {string | null} held who holds the test and why @param {string} recorder */
  update(held, recorder) {
    const listens = recorder !== "finished" && recorder !== "stopped";
    this.banner.hidden = held === null;
    this.button.hidden = held !== null || !listens;
    this.releaseButton.hidden = !listens;
    setText(byId("held-why"), held === null ? "" : `${held[0].toUpperCase()}${held.slice(1)}`);
  }

  ask() {
    this.reason.value = "";
    this.dialog.showModal();
    this.reason.focus();
  }

  hold() {
    this.dialog.close();
    void this.give("hold", this.button, "Hold", { note: this.reason.value.trim() });
  }

  /** @param {string} kind @param {HTMLButtonElement} button @param {string} word @param {object} args */
  async give(kind, button, word, args) {
    button.disabled = true;
    try {
      await order(kind, args, (text) => setText(button, text));
    } catch (error) {
      this.onTrouble(/** @type {Error} */ (error).message);
    }
    button.disabled = false;
    setText(button, word);
  }
}
