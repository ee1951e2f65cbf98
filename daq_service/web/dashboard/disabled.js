// List the disabled transducers with the reason, and a button that enables them again.

import { askConfirmation } from "./control/confirm.js";
import { isAllowed } from "./control/session.js";
import { el } from "./dom.js";
import { STATES, chip } from "./icons.js";
import { sendCommand } from "./commands.js";

export class DisabledTransducers {
  /** @param {HTMLElement} root @param {(text: string) => void} onTrouble */
  constructor(root, onTrouble) {
    this.root = root;
    this.onTrouble = onTrouble;
    this.shown = "";
    /** @type {Map<string, string>} status of our commands, by position */
    this.commandStatus = new Map();
    /** @type {any[]} */
    this.items = [];
    this.acceptsCommands = false;
  }

  /** @param {any} answer of /transducers */
  update(answer) {
    this.items = answer.items.filter((/** @type {any} */ { disabled_reason: reason }) => reason !== null);
    this.acceptsCommands = answer.as_of.recorder !== "finished" && answer.as_of.recorder !== "stopped";
    this.render();
  }

  render() {
    const content = JSON.stringify([
      this.acceptsCommands,
      [...this.commandStatus],
      this.items.map(({ position, disabled_reason: reason }) => [position, reason]),
    ]);
    if (content === this.shown) return;
    this.shown = content;
    const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.enable;
    this.root.hidden = this.items.length === 0;
    this.root.replaceChildren(...this.items.map((item) => this.row(item)));
    if (focused) /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-enable="${focused}"]`))?.focus();
  }

  /** @param {any} item of /transducers @returns {HTMLElement} */
  row({ position, disabled_reason: reason }) {
    const row = el(
      "div",
      { class: "banner", "data-tone": "alarm" },
      chip(STATES.disabled),
      el("p", {}, el("strong", { text: `Position ${position}: ` }), reason),
    );
    if (this.acceptsCommands && isAllowed("enable")) {
      const status = this.commandStatus.get(position);
      const button = el("button", {
        class: "button small",
        type: "button",
        "data-enable": position,
        disabled: status !== undefined,
        text: status ?? "Enable",
        "aria-label": `${status ?? "Enable"}: position ${position}`,
      });
      button.addEventListener("click", () => this.enable(position));
      row.append(button);
    }
    return row;
  }

  /** @param {string} position */
  async enable(position) {
    const paragraphs = [
      `Position ${position} strikes again from the next set. Keep hands out of the rig. The alarm that ` +
        "disabled it is reset.",
      "To undo it, disable it again.",
    ];
    const answers = await askConfirmation({
      title: `Enable position ${position}`,
      paragraphs,
      submitLabel: `Enable ${position}`,
    });
    if (answers === null) return;
    const report = (/** @type {string} */ text) => {
      this.commandStatus.set(position, text);
      this.render();
    };
    try {
      await sendCommand("enable", { position }, report);
    } catch (error) {
      this.onTrouble(/** @type {Error} */ (error).message);
    }
    this.commandStatus.delete(position);
    this.render();
  }
}
