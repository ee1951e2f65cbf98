// Copy a text to the clipboard with a button.

import { button, el, setText } from "./dom.js";

/**
 * @param {string} label of the button @param {() => string} text called when it is pressed
 * @param {() => string} fallback returns an instruction: over plain HTTP from another host a page has no clipboard
 * @returns {{button: HTMLElement, status: HTMLElement}}
 */
export function copyButton(label, text, fallback) {
  const status = el("span", { class: "quiet small", role: "status" });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text());
      setText(status, "Copied");
    } catch {
      setText(status, fallback());
    }
  };
  return { button: button(label, copy), status };
}
