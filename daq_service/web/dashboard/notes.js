// Show the annotations of the test: the list, and the dialog that adds to it.

import { isAllowed } from "./control/session.js";
import { button, el, setText } from "./dom.js";
import { fixed, utc } from "./format.js";
import { sendCommand } from "./commands.js";

/**
 * @typedef {{span: () => [number, number] | null, positions: () => string[], show: (span: [number, number]) => void,
 *   now: () => number}} Host
 */

/** @param {any} note */
const hours = (note) =>
  note.from_h === note.to_h
    ? `Hour ${fixed(note.from_h, 1)}`
    : `Hours ${fixed(note.from_h, 1)} to ${fixed(note.to_h, 1)}`;

export class SolimonNotes extends HTMLElement {
  constructor() {
    super();
    /** @type {Host} */
    this.host = /** @type {any} */ (null);
    /** @type {any[]} */
    this.items = [];
    this.count = el("p", { "aria-live": "polite", text: "Loading" });
    this.list = el("ul", { class: "alarm-list", "aria-labelledby": "notes-title" });
    this.addButton = button("Add note", () => this.ask(this.pointed ?? this.host.now(), ""), { hidden: true });
    const field = (/** @type {string} */ name, /** @type {string} */ type) =>
      /** @type {HTMLInputElement} */ (el("input", { class: "field", id: `note-${name}`, type, step: "any" }));
    this.from = field("from", "number");
    this.to = field("to", "number");
    this.from.required = true;
    this.text = /** @type {HTMLTextAreaElement} */ (
      el("textarea", { class: "field", id: "note-text", rows: "3", maxlength: "2000", required: true })
    );
    this.position = /** @type {HTMLSelectElement} */ (el("select", { class: "field", id: "note-position" }));
    this.shown = button("Visible range", () => this.setHours(this.host.span()));
    const now = button("Now", () => this.setHours([this.host.now(), this.host.now()]));
    this.trouble = el("p", { role: "alert" });
    const cancel = el("button", { class: "button ghost", type: "button", text: "Cancel" });
    const label = (/** @type {HTMLElement} */ input, /** @type {string} */ text) => [
      el("label", { for: input.id, text }),
      input,
    ];
    this.form = /** @type {HTMLFormElement} */ (
      el(
        "form",
        {},
        el("h2", { id: "note-title", text: "Add note" }),
        ...label(this.text, "Note"),
        ...label(this.from, "From hour"),
        ...label(this.to, "To hour (empty: one time)"),
        el("span", { class: "choices" }, now, this.shown),
        ...label(this.position, "Position"),
        this.trouble,
        el(
          "div",
          { class: "dialog-actions" },
          cancel,
          el("button", { class: "button", type: "submit", text: "Save note" }),
        ),
      )
    );
    this.dialog = /** @type {HTMLDialogElement} */ (el("dialog", { "aria-labelledby": "note-title" }, this.form));
    cancel.addEventListener("click", () => this.dialog.close());
    this.text.placeholder = "Ctrl+Enter saves";
    this.text.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) this.form.requestSubmit();
    });
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
    /** Last hour under the pointer on a chart. @type {number | null} */
    this.pointed = null;
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "notes-title");
    this.append(
      el(
        "div",
        { class: "card-head" },
        el("div", {}, el("h2", { id: "notes-title", text: "Notes" }), this.count),
        el("div", { class: "card-actions" }, this.addButton),
      ),
      this.list,
      this.dialog,
    );
  }

  /** @param {any[]} items those that are not withdrawn */
  update(items) {
    this.items = items;
    this.addButton.hidden = !isAllowed("annotate"); // from now on the positions of the test are known
    this.dataset.count = String(items.length);
    setText(
      this.count,
      items.length ? `${items.length} on this test` : "None. On a chart, press N to add a note at the cursor.",
    );
    this.list.hidden = !items.length;
    this.list.replaceChildren(...[...items].sort((a, b) => b.from_h - a.from_h).map((note) => this.item(note)));
  }

  /** @param {any} note @returns {HTMLElement} */
  item(note) {
    const showButton = el("button", {
      class: "link",
      type: "button",
      text: hours(note),
      "aria-label": `Show ${hours(note).toLowerCase()} on the charts`,
    });
    showButton.addEventListener("click", () => this.host.show([note.from_h, note.to_h]));
    const withdrawButton = button("Withdraw", (pressed) => this.withdraw(note.id, pressed), {
      "aria-label": `Withdraw: ${note.text}`,
      hidden: !isAllowed("withdraw_annotation"),
    });
    const item = el(
      "li",
      { class: "alarm" },
      el(
        "div",
        { class: "alarm-head" },
        showButton,
        el("strong", { text: note.position ?? "Whole test" }),
        el("span", { class: "quiet", text: `${note.author}, ${utc(note.written_utc)}` }),
      ),
      el("p", { class: "alarm-message", text: note.text }),
      el("div", { class: "alarm-foot" }, withdrawButton),
    );
    item.dataset.note = String(note.id);
    return item;
  }

  /** @param {number} hour @param {string} position empty: the complete test */
  ask(hour, position) {
    if (!isAllowed("annotate")) return;
    const names = this.host.positions();
    this.position.replaceChildren(
      el("option", { value: "", text: "Whole test" }),
      ...names.map((name) => el("option", { value: name, text: name })),
    );
    this.position.value = position;
    this.text.value = "";
    this.setHours([hour, hour]);
    this.shown.disabled = this.host.span() === null;
    setText(this.trouble, "");
    this.dialog.showModal();
    this.text.focus();
  }

  /** @param {[number, number] | null} span */
  setHours(span) {
    if (!span) return;
    this.from.value = String(Number(span[0].toFixed(3)));
    this.to.value = span[1] > span[0] ? String(Number(span[1].toFixed(3))) : "";
  }

  async save() {
    const note = {
      text: this.text.value,
      from_h: Number(this.from.value),
      to_h: this.to.value === "" ? null : Number(this.to.value),
      position: this.position.value || null,
    };
    try {
      await sendCommand("annotate", note, (text) => setText(this.trouble, text));
      this.dialog.close();
    } catch (error) {
      setText(this.trouble, /** @type {Error} */ (error).message);
    }
  }

  /** @param {number} id @param {HTMLButtonElement} button */
  async withdraw(id, button) {
    button.disabled = true;
    try {
      await sendCommand("withdraw_annotation", { annotation_id: id }, (text) => setText(button, text));
    } catch (error) {
      button.disabled = false;
      setText(button, "Withdraw");
      this.dispatchEvent(new CustomEvent("trouble", { detail: /** @type {Error} */ (error).message }));
    }
  }
}

/**
 * Return the ranges of annotations on charts.
 *
 * @param {any[]} notes
 * @param {string[]} positions
 * @returns {import("./charts/marks.js").Range[]}
 */
export function notesOn(notes, positions) {
  return notes
    .filter((note) => note.position === null || positions.includes(note.position))
    .map(({ from_h, to_h, text }) => ({ from_h, to_h, label: text.split("\n")[0].slice(0, 40), tone: "note" }));
}
