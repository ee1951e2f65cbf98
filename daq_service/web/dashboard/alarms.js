// The alarm list: what waits for an operator first, each with its proof.

import { post } from "./api.js";
import { author } from "./control/who.js";
import { el, setText } from "./dom.js";
import { hour, utc } from "./format.js";
import { SEVERITIES, chip } from "./icons.js";
import { follow, order } from "./orders.js";

const WAITING = new Set(["unacknowledged", "returned_unacknowledged"]);
const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
/** @type {Record<string, string>} */
const WORDS = {
  unacknowledged: "not acknowledged",
  acknowledged: "acknowledged",
  returned_unacknowledged: "returned to normal, not acknowledged",
  normal: "closed",
};

export class SolimonAlarms extends HTMLElement {
  constructor() {
    super();
    /** @type {any[]} */
    this.items = [];
    /** @type {Map<number, string>} what became of our orders, by alarm */
    this.orders = new Map();
    /** @type {Set<number>} alarms whose proof is open */
    this.opened = new Set();
    this.count = el("p", { "aria-live": "polite", text: "Reading" });
    this.list = el("ul", { class: "alarm-list" });
    this.none = el("p", { class: "no-alarms", text: "" });
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "alarms-title");
    this.append(el("div", { class: "card-head" }, el("div", {}, el("h2", { id: "alarms-title", text: "Alarms" }), this.count)), this.none, this.list);
  }

  /** @param {any[]} items */
  update(items) {
    this.items = [...items].sort(
      (a, b) =>
        Number(WAITING.has(b.state)) - Number(WAITING.has(a.state)) ||
        Number(b.state !== "normal") - Number(a.state !== "normal") ||
        RANK[/** @type {"critical"} */ (a.severity)] - RANK[/** @type {"critical"} */ (b.severity)] ||
        b.raised_h - a.raised_h,
    );
    const waiting = items.filter((item) => WAITING.has(item.state)).length;
    setText(this.count, items.length ? `${waiting} waiting for acknowledgement, ${items.length} in this test` : "None so far");
    this.dataset.count = String(items.length);
    setText(this.none, "No alarm has been raised in this test.");
    this.none.hidden = items.length > 0;
    this.list.hidden = items.length === 0;
    this.render();
  }

  render() {
    const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.focus;
    this.list.replaceChildren(...this.items.map((item) => this.item(item)));
    if (focused) /** @type {HTMLElement | null} */ (this.list.querySelector(`[data-focus="${focused}"]`))?.focus();
  }

  /** @param {any} alarm @returns {HTMLElement} */
  item(alarm) {
    const waiting = WAITING.has(alarm.state);
    const order = this.orders.get(alarm.id);
    const proof = el("details", {}, el("summary", { text: "Proof", "data-focus": `proof-${alarm.id}` }), el("pre", { class: "proof", tabindex: "0", text: JSON.stringify(alarm.proof, null, 1) }));
    /** @type {HTMLDetailsElement} */ (proof).open = this.opened.has(alarm.id);
    proof.addEventListener("toggle", () => (/** @type {HTMLDetailsElement} */ (proof).open ? this.opened.add(alarm.id) : this.opened.delete(alarm.id)));
    const foot = el("div", { class: "alarm-foot" }, proof);
    if (waiting) {
      const button = el("button", { class: "button small", type: "button", "data-focus": `ack-${alarm.id}`, disabled: order !== undefined, text: order ?? "Acknowledge" });
      button.setAttribute("aria-label", `Acknowledge: ${alarm.message}`);
      button.addEventListener("click", () => this.acknowledge(alarm.id));
      foot.append(button);
    }
    if (alarm.kind === "clock_doubted" && (alarm.state === "unacknowledged" || alarm.state === "acknowledged")) {
      const button = /** @type {HTMLButtonElement} */ (el("button", { class: "button small", type: "button", "data-focus": `trust-${alarm.id}`, text: "The clock is right" }));
      button.addEventListener("click", () => this.trustClock(button));
      foot.append(button);
    }
    if (alarm.position !== null && alarm.raised_set_index !== null) {
      // A link, so that it can be copied and sent as any other view.
      const link = el("a", { class: "small", href: `?position=${alarm.position}&set=${alarm.raised_set_index}`, "data-focus": `set-${alarm.id}`, text: "Open set", "aria-label": `Open set ${alarm.raised_set_index} of position ${alarm.position}` });
      link.addEventListener("click", (event) => {
        if (event.ctrlKey || event.metaKey || event.shiftKey) return;
        event.preventDefault();
        this.dispatchEvent(new CustomEvent("open-set", { detail: { position: alarm.position, set: alarm.raised_set_index } }));
      });
      foot.append(link);
    }
    const who = alarm.acknowledged_by ? ` by ${alarm.acknowledged_by}${alarm.note ? `: ${alarm.note}` : ""}` : "";
    const item = el(
      "li",
      { class: "alarm" },
      el(
        "div",
        { class: "alarm-head" },
        chip(SEVERITIES[alarm.severity] ?? SEVERITIES.low),
        el("strong", { text: `${alarm.position ?? "Service"} · hour ${hour(alarm.raised_h)}` }),
        el("span", { class: "quiet", text: utc(alarm.raised_utc) }),
      ),
      el("p", { class: "alarm-message", text: alarm.message }),
      el("p", { class: "quiet small", text: `${alarm.family} alarm, ${WORDS[alarm.state] ?? alarm.state}${who}` }),
      foot,
    );
    item.dataset.alarm = String(alarm.id);
    item.dataset.open = String(alarm.state !== "normal");
    return item;
  }

  /** @param {HTMLButtonElement} button */
  async trustClock(button) {
    button.disabled = true;
    try {
      await order("trust_clock", {}, (text) => setText(button, text));
    } catch (error) {
      button.disabled = false;
      setText(button, "The clock is right");
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
  }

  /** @param {number} id */
  async acknowledge(id) {
    const say = (/** @type {string} */ word) => {
      if (this.orders.get(id) === word) return;
      this.orders.set(id, word);
      this.render();
    };
    try {
      const name = await author();
      say("Sending");
      // The recorder's event brings the new state.
      await follow(await post(`/alarms/${id}/acknowledge`, { author: name }), say);
    } catch (error) {
      this.orders.delete(id);
      this.render();
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
  }
}
