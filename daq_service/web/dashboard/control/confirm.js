// Ask before a command is sent: no command is a single click, and the safe choice has the focus.

import { el, setText } from "../dom.js";

/**
 * @typedef {object} Field
 * @property {string} name
 * @property {string} label
 * @property {Record<string, string | boolean>} [input] attributes
 * @property {[string, string][]} [options] value and text of each choice; the first is selected
 * @property {boolean} [first] has the focus, instead of "Cancel"
 *
 * @typedef {object} Question
 * @property {string} title
 * @property {string[]} paragraphs consequences, in plain words
 * @property {string | ((values: Record<string, string>) => string)} submitLabel label of the button that sends it
 * @property {Field[]} [fields]
 */

/**
 * Show the consequences and wait; Escape and "Cancel" change nothing.
 *
 * @param {Question} question
 * @returns {Promise<Record<string, string> | null>} values of the fields; null: canceled
 */
export function askConfirmation({ title, paragraphs, submitLabel, fields = [] }) {
  const inputs = fields.map(
    (field) =>
      /** @type {HTMLInputElement} */ (
        field.options
          ? el(
              "select",
              { id: `confirm-${field.name}`, class: "field" },
              ...field.options.map(([value, text]) => el("option", { value, text })),
            )
          : el("input", {
              id: `confirm-${field.name}`,
              class: "field",
              type: "text",
              autocomplete: "off",
              maxlength: "200",
              ...field.input,
            })
      ),
  );
  const values = () => Object.fromEntries(fields.map((field, k) => [field.name, inputs[k].value.trim()]));
  const cancel = el("button", { class: "button ghost", type: "button", text: "Cancel" });
  const submit = el("button", { class: "button", type: "submit" });
  const form = el(
    "form",
    {},
    el("h2", { id: "confirm-title", text: title }),
    el("div", { id: "confirm-text" }, ...paragraphs.map((text) => el("p", { text }))),
    ...fields.map((field, k) =>
      el("div", { class: "labelled" }, el("label", { for: inputs[k].id, text: field.label }), inputs[k]),
    ),
    el("div", { class: "dialog-actions" }, cancel, submit),
  );
  const dialog = /** @type {HTMLDialogElement} */ (
    el("dialog", { id: "confirm", "aria-labelledby": "confirm-title", "aria-describedby": "confirm-text" }, form)
  );
  const name = () => setText(submit, typeof submitLabel === "string" ? submitLabel : submitLabel(values()));
  name();
  form.addEventListener("input", name);
  const opener = /** @type {HTMLElement | null} */ (document.activeElement);
  document.body.append(dialog);
  dialog.showModal();
  (inputs[fields.findIndex((field) => field.first)] ?? cancel).focus();
  return new Promise((resolve) => {
    /** @type {Record<string, string> | null} */
    let answers = null;
    cancel.addEventListener("click", () => dialog.close());
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      answers = values();
      dialog.close();
    });
    dialog.addEventListener("close", () => {
      dialog.remove();
      opener?.focus();
      resolve(answers);
    });
  });
}
