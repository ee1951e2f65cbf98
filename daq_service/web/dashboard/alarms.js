// Show the alarm list: alarms that wait for an operator first, each with its evidence.

import { AlarmFilter } from "./alarm-filter.js";
import { get, post } from "./api.js";
import { askConfirmation } from "./control/confirm.js";
import { authorName, isAllowed } from "./control/session.js";
import { button, el, setText } from "./dom.js";
import { hour, setKey, setName, utc } from "./format.js";
import { PRIORITIES, chip } from "./icons.js";
import { awaitResult, sendByButton, sendCommand } from "./commands.js";
import { AlarmEvidence, setLink } from "./alarm-evidence.js";
import { ShelveDialog, suppressedText, restoreAlarm } from "./shelve.js";

const WAITING = new Set(["unacknowledged", "returned_unacknowledged"]);
/** Kinds that a confirmation set can help to diagnose. */
const CONFIRMABLE = new Set(["wall_change", "transducer_change"]);
const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
/** @type {Record<string, string>} */
const STATE_LABELS = {
  unacknowledged: "not acknowledged",
  acknowledged: "acknowledged",
  returned_unacknowledged: "returned to normal, not acknowledged",
  normal: "closed",
};

/** @param {any} alarm */
const isWaiting = (alarm) => WAITING.has(alarm.state) && !alarm.suppressed;

export class SolimonAlarms extends HTMLElement {
  constructor() {
    super();
    /** Status of the command to trust the clock. @type {string | undefined} */
    this.trustClockStatus = undefined;
    /** Whether the test has finished and nothing strikes. */
    this.testEnded = false;
    /** @type {any[]} */
    this.items = [];
    /** @type {Map<number, string>} status of our commands, by alarm */
    this.commandStatus = new Map();
    /** @type {Map<number, AlarmEvidence>} by alarm; each keeps its open state */
    this.evidenceBoxes = new Map();
    /** @type {import("./alarm-evidence.js").Host} */
    this.host = /** @type {any} */ (null);
    /** @type {Map<number, HTMLElement>} histories that are open, by alarm */
    this.histories = new Map();
    /** @type {Set<number>} alarms whose guidance is open */
    this.openGuidance = new Set();
    /** @type {any[] | undefined} guidance for each kind */
    this.guidance = undefined;
    this.filter = new AlarmFilter(() => this.render());
    this.shelf = new ShelveDialog();
    this.count = el("p", { "aria-live": "polite", text: "Reading" });
    this.list = el("ul", { class: "alarm-list" });
    this.none = el("p", { class: "no-alarms", text: "" });
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "alarms-title");
    this.append(
      el("div", { class: "card-head" }, el("div", {}, el("h2", { id: "alarms-title", text: "Alarms" }), this.count)),
      this.filter.root,
      this.none,
      this.list,
      this.shelf.dialog,
    );
  }

  /** @param {any[]} items */
  update(items) {
    this.items = [...items].sort(
      (a, b) =>
        Number(isWaiting(b)) - Number(isWaiting(a)) ||
        Number(b.state !== "normal") - Number(a.state !== "normal") ||
        Number(Boolean(a.suppressed)) - Number(Boolean(b.suppressed)) ||
        RANK[/** @type {"critical"} */ (a.priority)] - RANK[/** @type {"critical"} */ (b.priority)] ||
        b.raised_h - a.raised_h,
    );
    const waiting = items.filter(isWaiting).length;
    const suppressedCount = items.filter((item) => item.suppressed && item.state !== "normal").length;
    setText(
      this.count,
      items.length
        ? `${waiting} waiting for acknowledgement, ` +
            (suppressedCount ? `${suppressedCount} shelved or out of service, ` : "") +
            `${items.length} in this test`
        : "None so far",
    );
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
    // The evidence stays the same element and keeps its focus.
    else if (active && this.list.contains(active)) active.focus({ preventScroll: true });
  }

  /** @param {any} alarm @returns {HTMLElement} */
  item(alarm) {
    const waiting = WAITING.has(alarm.state);
    const status = this.commandStatus.get(alarm.id);
    const evidence = this.evidenceBoxes.get(alarm.id) ?? new AlarmEvidence(alarm, this.host);
    this.evidenceBoxes.set(alarm.id, evidence);
    evidence.update(alarm);
    const foot = el("div", { class: "alarm-foot" }, evidence.root);
    /**
     * Add a button if the user's role allows its action.
     *
     * @param {string} key
     * @param {string} what
     * @param {string} text
     * @param {(button: HTMLButtonElement) => void} act
     * @param {Record<string, string | boolean>} [attributes]
     */
    const offer = (key, what, text, act, attributes = {}) => {
      if (isAllowed(what)) foot.append(button(text, act, { "data-focus": `${key}-${alarm.id}`, ...attributes }));
    };
    if (waiting) {
      const disabled = status !== undefined;
      offer("ack", "acknowledge_alarm", status ?? "Acknowledge", () => this.acknowledge(alarm.id, ""), {
        class: "button small",
        disabled,
        "aria-label": `Acknowledge: ${alarm.message}`,
      });
      offer("note", "acknowledge_alarm", "With a note", () => this.acknowledgeWithNote(alarm), {
        disabled,
        "aria-label": `Acknowledge with a note: ${alarm.message}`,
      });
    }
    const restore = (/** @type {HTMLButtonElement} */ pressed) => this.restoreAlarm(alarm, pressed);
    if (alarm.suppressed === "shelved")
      offer("restore", "unshelve_alarm", "Unshelve", restore, { class: "button small" });
    else if (alarm.suppressed)
      offer("restore", "return_to_service", "Return to service", restore, { class: "button small" });
    else if (alarm.state !== "normal")
      offer("shelve", "shelve_alarm", "Shelve", () => this.shelf.ask(alarm), {
        "aria-label": `Shelve: ${alarm.message}`,
      });
    foot.append(this.history(alarm.id), this.guidanceBox(alarm));
    if (alarm.kind === "clock_unverified" && (alarm.state === "unacknowledged" || alarm.state === "acknowledged"))
      offer("trust", "trust_clock", this.trustClockStatus ?? "The clock is right", () => this.trustClock(), {
        class: "button small",
        disabled: this.trustClockStatus !== undefined,
      });
    if (alarm.position !== null && alarm.raised_set_index !== null) {
      foot.append(
        setLink(
          alarm.position,
          alarm.raised_set_index,
          "Open set",
          {
            "data-focus": `set-${alarm.id}`,
            "aria-label": `Open set ${alarm.raised_set_index} of position ${alarm.position}`,
          },
          this.host.open,
        ),
      );
    }
    const confirmation = alarm.evidence?.confirmation;
    if (confirmation)
      foot.append(
        setLink(
          alarm.position,
          setKey(confirmation),
          "Open confirmation set",
          {
            "data-focus": `confirmation-${alarm.id}`,
            "aria-label": `Open ${setName(setKey(confirmation))} of position ${alarm.position}`,
          },
          this.host.open,
        ),
      );
    if (CONFIRMABLE.has(alarm.kind) && alarm.state !== "normal" && !this.testEnded)
      offer("strike", "strike", "Take confirmation set", (pressed) => this.strikeConfirmation(alarm, pressed), {
        "aria-label": `Strike a confirmation set at ${alarm.position} now`,
      });
    const at = `hour ${hour(alarm.raised_h)}`;
    const show = () =>
      this.dispatchEvent(new CustomEvent("show-hour", { detail: { position: alarm.position, hour: alarm.raised_h } }));
    const hourButton = button(at, show, {
      class: "link",
      "data-focus": `hour-${alarm.id}`,
      "aria-label": `Show ${at} of ${alarm.position ?? "the test"} on the charts and the waterfall`,
    });
    const note = alarm.note ? `: ${alarm.note}` : "";
    const acknowledger = alarm.acknowledged_by ? ` by ${alarm.acknowledged_by}${note}` : "";
    const item = el(
      "li",
      { class: "alarm" },
      el(
        "div",
        { class: "alarm-head" },
        chip(PRIORITIES[alarm.priority] ?? PRIORITIES.low),
        el("strong", {}, `${alarm.position ?? "Service"} · `, hourButton),
        el("span", { class: "quiet", text: utc(alarm.raised_utc) }),
      ),
      el("p", { class: "alarm-message", text: alarm.message }),
      el("p", {
        class: "quiet small",
        text: `${alarm.alarm_class} alarm, ${STATE_LABELS[alarm.state] ?? alarm.state}${acknowledger}`,
      }),
      ...(alarm.suppressed
        ? [
            el(
              "p",
              { class: "small shelved" },
              chip({
                label: alarm.suppressed === "shelved" ? "Shelved" : "Out of service",
                icon: "pause",
                tone: "info",
              }),
              ` ${suppressedText(alarm)}`,
            ),
          ]
        : []),
      foot,
    );
    item.dataset.alarm = String(alarm.id);
    item.dataset.open = String(alarm.state !== "normal");
    return item;
  }

  /** Draw open charts again, e.g. in the colors of another theme. */
  redraw() {
    for (const { chart } of this.evidenceBoxes.values()) chart?.draw();
  }

  /** Update the evidence after new sets. */
  renew() {
    for (const evidence of this.evidenceBoxes.values()) evidence.renew();
  }

  /** @param {any} alarm */
  guidanceBox(alarm) {
    const text = el("div", { class: "quiet" });
    const box = /** @type {HTMLDetailsElement} */ (
      el("details", {}, el("summary", { text: "What now", "data-focus": `now-${alarm.id}` }), text)
    );
    const read = async () => {
      try {
        const guidance = (this.guidance ??= /** @type {any[]} */ ((await get("/guidance")).items));
        const found = guidance.find((/** @type {any} */ one) => one.kind === alarm.kind);
        const plain = (/** @type {string} */ markdown) => markdown.replace(/[`*]/g, "");
        if (!found) setText(text, "Nothing is written of this kind of alarm.");
        else
          text.replaceChildren(
            el("p", { text: `It says: ${plain(found.meaning)}. It does not say ${plain(found.limitations)}.` }),
            el("ol", {}, ...found.checks.map((/** @type {string} */ step) => el("li", { text: plain(step) }))),
            el("p", { text: `Decides: ${plain(found.contact)}.` }),
          );
      } catch (error) {
        setText(text, /** @type {Error} */ (error).message);
      }
    };
    box.open = this.openGuidance.has(alarm.id);
    if (box.open) void read();
    box.addEventListener("toggle", () => {
      if (!box.open) this.openGuidance.delete(alarm.id);
      else if (!this.openGuidance.has(alarm.id)) {
        this.openGuidance.add(alarm.id);
        void read();
      }
    });
    return box;
  }

  /** List all transitions, read when the list is opened and after each change. @param {number} id */
  history(id) {
    const lines = this.histories.get(id) ?? el("ul", { class: "quiet" });
    const box = /** @type {HTMLDetailsElement} */ (
      el("details", {}, el("summary", { text: "History", "data-focus": `history-${id}` }), lines)
    );
    const read = async () => {
      try {
        const { items } = await get(`/alarms/${id}/history`);
        lines.replaceChildren(
          ...items.map((/** @type {any} */ one) =>
            el("li", {
              text: [
                utc(one.utc),
                one.kind.replace("alarm_", "").replaceAll("_", " "),
                one.author ? `by ${one.author}` : "",
                one.reason,
              ]
                .filter(Boolean)
                .join(" · "),
            }),
          ),
        );
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
  async restoreAlarm(alarm, button) {
    button.disabled = true;
    try {
      await restoreAlarm(alarm, (text) => setText(button, text));
    } catch (error) {
      button.disabled = false;
      this.dispatchEvent(new CustomEvent("trouble", { detail: /** @type {Error} */ (error).message }));
    }
  }

  /** @param {any} alarm @param {HTMLButtonElement} button */
  async strikeConfirmation(alarm, button) {
    await sendByButton(button, "strike", { position: alarm.position }, (detail) =>
      this.dispatchEvent(new CustomEvent("trouble", { detail })),
    );
  }

  async trustClock() {
    // The list keeps the status: it may replace the button while the command waits.
    const report = (/** @type {string | undefined} */ text) => {
      this.trustClockStatus = text;
      this.render();
    };
    try {
      await sendCommand("trust_clock", {}, report);
    } catch (error) {
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
    report(undefined);
  }

  /** @param {any} alarm */
  async acknowledgeWithNote(alarm) {
    const answers = await askConfirmation({
      title: "Acknowledge an alarm",
      paragraphs: [
        `${alarm.position ?? "Service"}: ${alarm.message}.`,
        "The note stands beside the alarm and in its history.",
      ],
      submitLabel: "Acknowledge",
      fields: [
        { name: "note", label: "Note", first: true, input: { required: true, maxlength: "2000", pattern: ".*\\S.*" } },
      ],
    });
    if (answers) await this.acknowledge(alarm.id, answers.note);
  }

  /** @param {number} id @param {string} note */
  async acknowledge(id, note) {
    const report = (/** @type {string} */ text) => {
      if (this.commandStatus.get(id) === text) return;
      this.commandStatus.set(id, text);
      this.render();
    };
    try {
      const name = await authorName();
      report("Sending");
      // The recorder's event brings the new state.
      await awaitResult(await post(`/alarms/${id}/acknowledge`, { author: name, note }), report);
    } catch (error) {
      this.commandStatus.delete(id);
      this.render();
      this.dispatchEvent(new CustomEvent("trouble", { detail: String(/** @type {Error} */ (error).message) }));
    }
  }
}
