// Shelve an alarm for a time and a reason. It is shown again when the time is over or a person unshelves it.

import { el, setText } from "./dom.js";
import { utc } from "./format.js";
import { sendCommand } from "./commands.js";

const LENGTHS = [
  ["1", "1 hour"],
  ["8", "8 hours"],
  ["24", "24 hours"],
  ["72", "72 hours"],
  ["", "until it is returned to service"],
];

/** Return how and why an alarm is suppressed; empty: it is not. @param {any} alarm */
export function suppressedText(alarm) {
  if (!alarm.suppressed) return "";
  const state = alarm.suppressed === "shelved" ? `shelved until ${utc(alarm.shelved_until_utc)}` : "out of service";
  const { suppressed_by: author, suppressed_reason: reason } = alarm;
  return `${state} by ${author}: ${reason}`;
}

/** @param {any} alarm @param {(text: string) => void} report */
export async function restoreAlarm(alarm, report) {
  await sendCommand(
    alarm.suppressed === "shelved" ? "unshelve_alarm" : "return_to_service",
    { alarm_id: alarm.id },
    report,
  );
}

export class ShelveDialog {
  constructor() {
    this.id = 0;
    this.what = el("p", { class: "quiet" });
    this.reason = /** @type {HTMLInputElement} */ (
      el("input", {
        class: "field",
        id: "shelf-reason",
        type: "text",
        maxlength: "500",
        autocomplete: "off",
        required: true,
      })
    );
    this.length = /** @type {HTMLSelectElement} */ (
      el(
        "select",
        { class: "field", id: "shelf-length" },
        ...LENGTHS.map(([value, text]) => el("option", { value, text })),
      )
    );
    this.trouble = el("p", { role: "alert" });
    const cancel = el("button", { class: "button ghost", type: "button", text: "Cancel" });
    const form = el(
      "form",
      {},
      el("h2", { id: "shelf-title", text: "Shelve an alarm" }),
      this.what,
      el("label", { for: "shelf-reason", text: "Why it is shelved" }),
      this.reason,
      el("label", { for: "shelf-length", text: "For, in hours of the test or in real time, whichever pass first" }),
      this.length,
      this.trouble,
      el(
        "div",
        { class: "dialog-actions" },
        cancel,
        el("button", { class: "button", type: "submit", text: "Shelve it" }),
      ),
    );
    this.dialog = /** @type {HTMLDialogElement} */ (el("dialog", { "aria-labelledby": "shelf-title" }, form));
    cancel.addEventListener("click", () => this.dialog.close());
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
  }

  /** @param {any} alarm */
  ask(alarm) {
    this.id = alarm.id;
    setText(
      this.what,
      `${alarm.position ?? "Service"}: ${alarm.message}. It goes on through its states and is counted ` +
        "apart; if it grows worse it comes off the shelf.",
    );
    this.reason.value = "";
    this.length.value = "8";
    setText(this.trouble, "");
    this.dialog.showModal();
    this.reason.focus();
  }

  async save() {
    const hours = this.length.value;
    try {
      const args = { alarm_id: this.id, reason: this.reason.value };
      await sendCommand(
        hours ? "shelve_alarm" : "take_out_of_service",
        hours ? { ...args, for_h: Number(hours) } : args,
        (text) => setText(this.trouble, text),
      );
      this.dialog.close();
    } catch (error) {
      setText(this.trouble, /** @type {Error} */ (error).message);
    }
  }
}
