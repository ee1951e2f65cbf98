// Transducers that strike no more: why, and a button for when that is put right.

import { confirmed } from "./control/confirm.js";
import { may } from "./control/session.js";
import { el } from "./dom.js";
import { STATES, chip } from "./icons.js";
import { order } from "./commands.js";

export class Retired {
  /** @param {HTMLElement} root @param {(text: string) => void} onTrouble */
  constructor(root, onTrouble) {
    this.root = root;
    this.onTrouble = onTrouble;
    this.shown = "";
    /** @type {Map<string, string>} what became of our orders, by position */
    this.orders = new Map();
    /** @type {any[]} */
    this.items = [];
    this.listens = false;
  }

  /** @param {any} answer of /transducers */
  update(answer) {
    this.items = answer.items.filter((/** @type {any} */ item) => item.retired_because !== null);
    this.listens = answer.as_of.recorder !== "finished" && answer.as_of.recorder !== "stopped";
    this.render();
  }

  render() {
    const facts = JSON.stringify([this.listens, [...this.orders], this.items.map((item) => [item.position, item.retired_because])]);
    if (facts === this.shown) return;
    this.shown = facts;
    const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.reinstate;
    this.root.hidden = this.items.length === 0;
    this.root.replaceChildren(...this.items.map((item) => this.row(item)));
    if (focused) /** @type {HTMLElement | null} */ (this.root.querySelector(`[data-reinstate="${focused}"]`))?.focus();
  }

  /** @param {any} item @returns {HTMLElement} */
  row(item) {
    const row = el("div", { class: "banner", "data-tone": "alarm" }, chip(STATES.retired), el("p", {}, el("strong", { text: `Position ${item.position}: ` }), item.retired_because));
    if (this.listens && may("reinstate")) {
      const word = this.orders.get(item.position);
      const button = el("button", { class: "button small", type: "button", "data-reinstate": item.position, disabled: word !== undefined, text: word ?? "Reinstate", "aria-label": `${word ?? "Reinstate"}: position ${item.position}` });
      button.addEventListener("click", () => this.reinstate(item.position));
      row.append(button);
    }
    return row;
  }

  /** @param {string} position */
  async reinstate(position) {
    const says = [`Position ${position} strikes again from the next set on: hands out of the rig. The alarm that retired it is reset.`, "To take it back, retire it again."];
    const given = await confirmed({ title: `Reinstate position ${position}`, says, word: `Reinstate ${position}` });
    if (given === null) return;
    const say = (/** @type {string} */ text) => {
      this.orders.set(position, text);
      this.render();
    };
    try {
      await order("reinstate", { position }, say);
    } catch (error) {
      this.onTrouble(/** @type {Error} */ (error).message);
    }
    this.orders.delete(position);
    this.render();
  }
}
