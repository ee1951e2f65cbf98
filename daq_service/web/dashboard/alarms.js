// The alarm list: what waits for an operator first, each with its proof.

import { AlarmFilter } from "./alarm-filter.js";
import { get, post } from "./api.js";
import { confirmed } from "./control/confirm.js";
import { author, may } from "./control/session.js";
import { button, el, setText } from "./dom.js";
import { hour, setName, utc } from "./format.js";
import { SEVERITIES, chip } from "./icons.js";
import { follow, giveBy, order } from "./commands.js";
import { Proof, setLink } from "./alarm-evidence.js";
import { ShelfDialog, suppressedText, tellAgain } from "./shelve.js";

const WAITING = new Set(["unacknowledged", "returned_unacknowledged"]);
/** Kinds that a confirmation set may tell more of. */
const CONFIRMED = new Set(["wall_change", "transducer_change"]);
const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
/** @type {Record<string, string>} */
const WORDS = {
  unacknowledged: "not acknowledged",
  acknowledged: "acknowledged",
  returned_unacknowledged: "returned to normal, not acknowledged",
  normal: "closed",
};

/** @param {any} alarm */
const waits = (alarm) => WAITING.has(alarm.state) && !alarm.suppressed;

export class SolimonAlarms extends HTMLElement {
  constructor() {
    super();
    /** What has become of the order to trust the clock. @type {string | undefined} */
    this.trusting = undefined;
    /** @type {any[]} */
    this.items = [];
    /** @type {Map<number, string>} what became of our orders, by alarm */
    this.orders = new Map();
    /** @type {Map<number, Proof>} by alarm; each keeps what is open of it */
    this.proofs = new Map();
    /** @type {import("./alarm-evidence.js").Host} */
    this.host = /** @type {any} */ (null);
    /** @type {Map<number, HTMLElement>} histories that are open, by alarm */
    this.histories = new Map();
    /** @type {Set<number>} alarms whose guidance is open */
    this.advised = new Set();
    /** @type {any[] | undefined} what to do, by kind */
    this.guidance = undefined;
    this.filter = new AlarmFilter(() => this.render());
    this.shelf = new ShelfDialog();
    this.count = el("p", { "aria-live": "polite", text: "Reading" });
    this.list = el("ul", { class: "alarm-list" });
    this.none = el("p", { class: "no-alarms", text: "" });
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "alarms-title");
    this.append(el("div", { class: "card-head" }, el("div", {}, el("h2", { id: "alarms-title", text: "Alarms" }), this.count)), this.filter.root, this.none, this.list, this.shelf.dialog);
  }

  /** @param {any[]} items */
  update(items) {
    this.items = [...items].sort(
      (a, b) =>
        Number(waits(b)) - Number(waits(a)) ||
        Number(b.state !== "normal") - Number(a.state !== "normal") ||
        Number(Boolean(a.suppressed)) - Number(Boolean(b.suppressed)) ||
        RANK[/** @type {"critical"} */ (a.severity)] - RANK[/** @type {"critical"} */ (b.severity)] ||
        b.raised_h - a.raised_h,
    );
    const waiting = items.filter(waits).length;
    const apart = items.filter((item) => item.suppressed && item.state !== "normal").length;
    setText(this.count, items.length ? `${waiting} waiting for acknowledgement, ${apart ? `${apart} shelved or out of service, ` : ""}${items.length} in this test` : "None so far");
    this.filter.offer(items);
    this.filter.root.hidden = items.length === 0;
    this.dataset.count = String(items.length);
    setText(this.none, "No alarm has been raised in this test.");
    this.none.hidden = items.length > 0;
    this.list.hidden = items.length === 0;
    this.render();
  }

  render() {
    const active = /** @type {HTMLElement | null} */ (document.activeElement);
    const focused = active?.dataset?.focus;
    this.list.replaceChildren(...this.items.filter((item) => this.filter.shows(item)).map((item) => this.item(item)));
    if (focused) /** @type {HTMLElement | null} */ (this.list.querySelector(`[data-focus="${focused}"]`))?.focus();
    // A proof stays the same element, with what is in it.
    else if (active && this.list.contains(active)) active.focus({ preventScroll: true });
  }

  /** @param {any} alarm @returns {HTMLElement} */
  item(alarm) {
    const waiting = WAITING.has(alarm.state);
    const order = this.orders.get(alarm.id);
    const proof = this.proofs.get(alarm.id) ?? new Proof(alarm, this.host);
    this.proofs.set(alarm.id, proof);
    proof.update(alarm);
    const foot = el("div", { class: "alarm-foot" }, proof.root);
    /** A button, for those whose role allows it. @param {string} key @param {string} what @param {string} text @param {(button: HTMLButtonElement) => void} act @param {Record<string, string | boolean>} [attributes] */
    const offer = (key, what, text, act, attributes = {}) => {
      if (may(what)) foot.append(button(text, act, { "data-focus": `${key}-${alarm.id}`, ...attributes }));
    };
    if (waiting) {
      const disabled = order !== undefined;
      offer("ack", "acknowledge_alarm", order ?? "Acknowledge", () => this.acknowledge(alarm.id, ""), { class: "button small", disabled, "aria-label": `Acknowledge: ${alarm.message}` });
      offer("note", "acknowledge_alarm", "With a note", () => this.acknowledgeWithNote(alarm), { disabled, "aria-label": `Acknowledge with a note: ${alarm.message}` });
    }
    const again = (/** @type {HTMLButtonElement} */ pressed) => this.tellAgain(alarm, pressed);
    if (alarm.suppressed === "shelved") offer("tell", "unshelve_alarm", "Unshelve", again, { class: "button small" });
    else if (alarm.suppressed) offer("tell", "return_to_service", "Return to service", again, { class: "button small" });
    else if (alarm.state !== "normal") offer("shelve", "shelve_alarm", "Shelve", () => this.shelf.ask(alarm), { "aria-label": `Shelve: ${alarm.message}` });
    foot.append(this.history(alarm.id), this.whatNow(alarm));
    if (alarm.kind === "clock_doubted" && (alarm.state === "unacknowledged" || alarm.state === "acknowledged")) offer("trust", "trust_clock", this.trusting ?? "The clock is right", () => this.trustClock(), { class: "button small", disabled: this.trusting !== undefined });
    if (alarm.position !== null && alarm.raised_set_index !== null) {
      foot.append(setLink(alarm.position, alarm.raised_set_index, "Open set", { "data-focus": `set-${alarm.id}`, "aria-label": `Open set ${alarm.raised_set_index} of position ${alarm.position}` }, this.host.open));
    }
    const beside = alarm.proof?.confirmation?.set_index;
    if (beside != null) foot.append(setLink(alarm.position, beside, "Open confirmation set", { "data-focus": `beside-${alarm.id}`, "aria-label": `Open ${setName(beside)} of position ${alarm.position}` }, this.host.open));
    if (CONFIRMED.has(alarm.kind) && alarm.state !== "normal") offer("confirm", "confirm", "Strike again now", (pressed) => this.strikeAgain(alarm, pressed), { "aria-label": `Strike a confirmation set at ${alarm.position} now` });
    const at = `hour ${hour(alarm.raised_h)}`;
    const show = () => this.dispatchEvent(new CustomEvent("show-hour", { detail: { position: alarm.position, hour: alarm.raised_h } }));
    const goes = button(at, show, { class: "link", "data-focus": `hour-${alarm.id}`, "aria-label": `Show ${at} of ${alarm.position ?? "the test"} on the charts and the waterfall` });
    const who = alarm.acknowledged_by ? ` by ${alarm.acknowledged_by}${alarm.note ? `: ${alarm.note}` : ""}` : "";
    const item = el(
      "li",
      { class: "alarm" },
      el(
        "div",
        { class: "alarm-head" },
        chip(SEVERITIES[alarm.severity] ?? SEVERITIES.low),
        el("strong", {}, `${alarm.position ?? "Service"} · `, goes),
        el("span", { class: "quiet", text: utc(alarm.raised_utc) }),
      ),
      el("p", { class: "alarm-message", text: alarm.message }),
      el("p", { class: "quiet small", text: `${alarm.family} alarm, ${WORDS[alarm.state] ?? alarm.state}${who}` }),
      ...(alarm.suppressed ? [el("p", { class: "small shelved" }, chip({ word: alarm.suppressed === "shelved" ? "Shelved" : "Out of service", icon: "pause", tone: "info" }), ` ${suppressedText(alarm)}`)] : []),
      foot,
    );
    item.dataset.alarm = String(alarm.id);
    item.dataset.open = String(alarm.state !== "normal");
    return item;
  }

  /** Draw what is open anew, e.g. in the colours of another theme. */
  redraw() {
    for (const { chart } of this.proofs.values()) chart?.draw();
  }

  /** Sets have come. */
  renew() {
    for (const proof of this.proofs.values()) proof.renew();
  }

  /** @param {any} alarm */
  whatNow(alarm) {
    const text = el("div", { class: "quiet" });
    const box = /** @type {HTMLDetailsElement} */ (el("details", {}, el("summary", { text: "What now", "data-focus": `now-${alarm.id}` }), text));
    const read = async () => {
      try {
        const guidance = (this.guidance ??= /** @type {any[]} */ ((await get("/guidance")).items));
        const found = guidance.find((/** @type {any} */ one) => one.kind === alarm.kind);
        const plain = (/** @type {string} */ words) => words.replace(/[`*]/g, "");
        if (!found) setText(text, "Nothing is written of this kind of alarm.");
        else text.replaceChildren(el("p", { text: `It says: ${plain(found.says)}. It does not say ${plain(found.does_not_say)}.` }), el("ol", {}, ...found.look_first.map((/** @type {string} */ step) => el("li", { text: plain(step) }))), el("p", { text: `Decides: ${plain(found.call)}.` }));
      } catch (error) {
        setText(text, /** @type {Error} */ (error).message);
      }
    };
    box.open = this.advised.has(alarm.id);
    if (box.open) void read();
    box.addEventListener("toggle", () => {
      if (!box.open) this.advised.delete(alarm.id);
      else if (!this.advised.has(alarm.id)) {
        this.advised.add(alarm.id);
        void read();
      }
    });
    return box;
  }

  /** Every transition, read when it is opened and whenever something has changed since. @param {number} id */
  history(id) {
    const lines = this.histories.get(id) ?? el("ul", { class: "quiet" });
    const box = /** @type {HTMLDetailsElement} */ (el("details", {}, el("summary", { text: "History", "data-focus": `history-${id}` }), lines));
    const read = async () => {
      try {
        const { items } = await get(`/alarms/${id}/history`);
        lines.replaceChildren(...items.map((/** @type {any} */ one) => el("li", { text: [utc(one.utc), one.kind.replace("alarm_", "").replaceAll("_", " "), one.who ? `by ${one.who}` : "", one.why].filter(Boolean).join(" · ") })));
      } catch (error) {
        setText(lines, /** @type {Error} */ (error).message);
      }
    };
    if (this.histories.has(id)) void read();
    box.open = this.histories.has(id);
    box.addEventListener("toggle", () => {
      if (!box.open) this.histories.delete(id);
      else if (!this.histories.has(id)) {
        this.histories.set(id, lines);
        void read();
      }
    });
    return box;
  }

  /** @param {any} alarm @param {HTMLButtonElement} button */
  async tellAgain(alarm, button) {
    button.disabled = true;
    try {
      await tellAgain(alarm, (word) => setText(button, word));
    } catch (error) {
      button.disabled = false;
      this.dispatchEvent(new CustomEvent("trouble", { detail: /** @type {Error} */ (error).message }));
    }
  }

  /** @param {any} alarm @param {HTMLButtonElement} button */
  async strikeAgain(alarm, button) {
    await giveBy(button, "confirm", { position: alarm.position }, (detail) => this.dispatchEvent(new CustomEvent("trouble", { detail })));
  }

  async trustClock() {
    // Not said by the button itself: the list may be drawn anew meanwhile.
    const say = (/** @type {string | undefined} */ text) => {
      this.trusting = text;
      this.render();
    };
    try {
      await order("trust_clock", {}, say);
    } catch (error) {
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
    say(undefined);
  }

  /** @param {any} alarm */
  async acknowledgeWithNote(alarm) {
    const given = await confirmed({
      title: "Acknowledge an alarm",
      says: [`${alarm.position ?? "Service"}: ${alarm.message}.`, "The note stands beside the alarm and in its history."],
      word: "Acknowledge",
      fields: [{ name: "note", label: "Note", first: true, input: { required: true, maxlength: "2000", pattern: ".*\\S.*" } }],
    });
    if (given) await this.acknowledge(alarm.id, given.note);
  }

  /** @param {number} id @param {string} note */
  async acknowledge(id, note) {
    const say = (/** @type {string} */ word) => {
      if (this.orders.get(id) === word) return;
      this.orders.set(id, word);
      this.render();
    };
    try {
      const name = await author();
      say("Sending");
      // The recorder's event brings the new state.
      await follow(await post(`/alarms/${id}/acknowledge`, { author: name, note }), say);
    } catch (error) {
      this.orders.delete(id);
      this.render();
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
  }
}
