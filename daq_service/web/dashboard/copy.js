// A button that puts a text on the clipboard, and says so.

import { button, el, setText } from "./dom.js";

/**
 * @param {string} word of the button @param {() => string} text asked when it is pressed
 * @param {() => string} otherwise what else to do: over plain HTTP from elsewhere a page has no clipboard, a person has
 * @returns {{button: HTMLElement, said: HTMLElement}}
 */
export function copyButton(word, text, otherwise) {
  const said = el("span", { class: "quiet small", role: "status" });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text());
      setText(said, "Copied");
    } catch {
      setText(said, otherwise());
    }
  };
  return { button: button(word, copy), said };
}
