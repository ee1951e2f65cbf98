// Show details in a dialog above the page: to open them moves nothing else.

import { button, el, setText } from "./dom.js";

export class DetailsDialog {
  constructor() {
    this.heading = el("h2", { id: "details-title" });
    this.body = el("div", { class: "details-body", tabindex: "0", role: "region", "aria-labelledby": "details-title" });
    this.dialog = /** @type {HTMLDialogElement} */ (
      el(
        "dialog",
        { class: "details", "aria-labelledby": "details-title" },
        el(
          "div",
          { class: "card-head" },
          el("div", {}, this.heading),
          button("Close", () => this.dialog.close()),
        ),
        this.body,
      )
    );
    /** Called when the page has new data. */
    this.renew = () => {};
    /** Returns the button that opened it, which the list may have made again. @type {() => HTMLElement | null} */
    this.opener = () => null;
    this.dialog.addEventListener("close", () => {
      this.renew = () => {};
      this.body.replaceChildren();
      this.opener()?.focus();
    });
  }

  /** @param {string} title @param {Node} content @param {() => void} [renew] */
  show(title, content, renew = () => {}) {
    const key = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset.focus;
    this.opener = () => (key ? document.querySelector(`[data-focus="${key}"]`) : null);
    this.renew = renew;
    setText(this.heading, title);
    this.body.replaceChildren(content);
    this.dialog.showModal();
    this.body.scrollTop = 0;
  }
}
