// What is drawn over what, against what, over which hours: one row for all charts.

import { copyButton } from "../copy.js";
import { button, byId, el, setText } from "../dom.js";
import { exportMenu, testOffer } from "../export.js";
import { fixed } from "../format.js";

/** @typedef {import("../view.js").View} View */

const DAY_H = 24;

export class Toolbar {
  /** @param {(part: Partial<View>) => void} go @param {() => number} now hour of the test */
  constructor(go, now) {
    this.root = byId("toolbar");
    this.go = go;
    this.over = el("span", { class: "choices", role: "group", "aria-label": "Draw over it" });
    this.relative = el("button", { class: "button ghost small", type: "button", text: "Relative to baseline" });
    this.axis = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": "Time axis" }));
    for (const [value, text] of [["hours", "Hours of the test"], ["utc", "UTC"], ["local", "Local time"]]) this.axis.append(el("option", { value, text }));
    this.span = el("span", { class: "quiet small", "aria-live": "polite" });
    this.whole = button("Whole test", () => go({ from_h: null, to_h: null }));
    const day = button("Last 24 h", () => {
      // The set of this very hour is seen, too.
      const to_h = Math.floor(now()) + 1;
      go({ from_h: Math.max(0, to_h - DAY_H), to_h });
    });
    this.link = copyButton("Copy link", () => location.href, () => "The link is the page's address: copy it there");
    this.axis.addEventListener("change", () => go({ axis: /** @type {any} */ (this.axis.value) }));
    this.root.append(this.over, this.relative, this.axis, day, this.whole, this.span, this.link.said, this.link.button, exportMenu("the test", () => testOffer(this.shown)));
    /** @type {[number, number] | null} */
    this.shown = null;
    this.made = "";
    this.linked = "";
  }

  /** @param {View} view @param {string} charted @param {any} info @param {import("../timeline.js").Timeline} timeline */
  update(view, charted, info, timeline) {
    const places = info.positions.filter((/** @type {any} */ place) => place.method === "solitary_wave").map((/** @type {any} */ place) => place.position);
    const made = JSON.stringify([places, charted, view.compare]);
    if (made !== this.made) {
      this.made = made;
      const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.compare;
      const buttons = places.filter((/** @type {string} */ position) => position !== charted).map((/** @type {string} */ position) => {
        const chosen = view.compare.includes(position);
        const compare = chosen ? view.compare.filter((one) => one !== position) : [...view.compare, position];
        return button(`with ${position}`, () => this.go({ compare }), { "aria-pressed": String(chosen), "data-compare": position });
      });
      this.over.replaceChildren(...buttons);
      if (focused) /** @type {HTMLElement | null} */ (this.over.querySelector(`[data-compare="${focused}"]`))?.focus();
    }
    this.relative.setAttribute("aria-pressed", String(view.relative));
    this.relative.onclick = () => this.go({ relative: !view.relative });
    this.axis.value = view.axis;
    this.whole.disabled = view.from_h === null;
    this.shown = view.from_h === null || view.to_h === null ? null : [view.from_h, view.to_h];
    const text = view.from_h === null || view.to_h === null ? "" : `hour ${fixed(view.from_h, 1)} to ${fixed(view.to_h, 1)}${timeline.axis === "hours" ? "" : ` · ${timeline.text(view.from_h)} to ${timeline.text(view.to_h)}`}`;
    setText(this.span, text);
    if (this.linked !== location.href) setText(this.link.said, "");
    this.linked = location.href;
    this.root.hidden = false;
  }
}
