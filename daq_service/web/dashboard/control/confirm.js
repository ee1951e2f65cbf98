// Asks before something is done: no order is a single click, and the safe choice has the focus.

import { el, setText } from "../dom.js";

/**
 * @typedef {object} Field
 * @property {string} name
 * @property {string} label
 * @property {Record<string, string | boolean>} [input] attributes
 * @property {boolean} [first] has the focus, instead of "Cancel"
 *
 * @typedef {object} Question
 * @property {string} title
 * @property {string[]} says what follows, in plain words
 * @property {string | ((values: Record<string, string>) => string)} word of the button that does it
 * @property {Field[]} [fields]
 */

/**
 * Show what would follow, and wait; Escape and "Cancel" leave everything as it is.
 *
 * @param {Question} question
 * @returns {Promise<Record<string, string> | null>} what was filled in; null: nothing shall be done
 */
export function confirmed({ title, says, word, fields = [] }) {
  const inputs = fields.map((field) => /** @type {HTMLInputElement} */ (el("input", { id: `confirm-${field.name}`, class: "field", type: "text", autocomplete: "off", maxlength: "200", ...field.input })));
  const values = () => Object.fromEntries(fields.map((field, k) => [field.name, inputs[k].value.trim()]));
  const cancel = el("button", { class: "button ghost", type: "button", text: "Cancel" });
  const go = el("button", { class: "button", type: "submit" });
  const form = el(
    "form",
    {},
    el("h2", { id: "confirm-title", text: title }),
    el("div", { id: "confirm-says" }, ...says.map((text) => el("p", { text }))),
    ...fields.map((field, k) => el("div", { class: "labelled" }, el("label", { for: inputs[k].id, text: field.label }), inputs[k])),
    el("div", { class: "dialog-actions" }, cancel, go),
  );
  const dialog = /** @type {HTMLDialogElement} */ (el("dialog", { id: "confirm", "aria-labelledby": "confirm-title", "aria-describedby": "confirm-says" }, form));
  const name = () => setText(go, typeof word === "string" ? word : word(values()));
  name();
  form.addEventListener("input", name);
  const asker = /** @type {HTMLElement | null} */ (document.activeElement);
  document.body.append(dialog);
  dialog.showModal();
  (inputs[fields.findIndex((field) => field.first)] ?? cancel).focus();
  return new Promise((resolve) => {
    /** @type {Record<string, string> | null} */
    let given = null;
    cancel.addEventListener("click", () => dialog.close());
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      given = values();
      dialog.close();
    });
    dialog.addEventListener("close", () => {
      dialog.remove();
      asker?.focus();
      resolve(given);
    });
  });
}
