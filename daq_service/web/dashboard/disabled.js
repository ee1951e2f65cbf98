// List the disabled transducers with the reason, and a button that enables them again.

import { askConfirmation } from "./control/confirm.js";
import { isAllowed } from "./control/session.js";
import { button, el } from "./dom.js";
import { STATES, chip } from "./icons.js";
import { sendByButton } from "./commands.js";

export class DisabledTransducers {
  /** @param {HTMLElement} root @param {(text: string) => void} onTrouble */
  constructor(root, onTrouble) {
    this.root = root;
    this.onTrouble = onTrouble;
    this.shown = "";
  }

  /** @param {any} answer of /transducers */
  update({ items, as_of: { recorder } }) {
    const disabled = items.filter((/** @type {any} */ { disabled_reason: reason }) => reason !== null);
    const mayEnable = recorder !== "finished" && recorder !== "stopped" && isAllowed("enable");
    const content = JSON.stringify([
      mayEnable,
      disabled.map((/** @type {any} */ { position, disabled_reason: reason }) => [position, reason]),
    ]);
    if (content === this.shown) return;
    this.shown = content;
    this.root.hidden = disabled.length === 0;
    this.root.replaceChildren(...disabled.map((/** @type {any} */ item) => this.row(item, mayEnable)));
  }

  /** @param {any} item of /transducers @param {boolean} mayEnable @returns {HTMLElement} */
  row({ position, disabled_reason: reason }, mayEnable) {
    const row = el(
      "div",
      { class: "banner", "data-tone": "alarm" },
      chip(STATES.disabled),
      el("p", {}, el("strong", { text: `Position ${position}: ` }), reason),
    );
    if (mayEnable)
      row.append(
        button("Enable", (pressed) => this.enable(position, pressed), {
          class: "button small",
          "aria-label": `Enable: position ${position}`,
        }),
      );
    return row;
  }

  /** @param {string} position @param {HTMLButtonElement} pressed */
  async enable(position, pressed) {
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
    if (answers !== null) await sendByButton(pressed, "enable", { position }, this.onTrouble);
  }
}
