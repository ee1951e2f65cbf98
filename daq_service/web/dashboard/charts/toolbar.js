// Choose positions, reference and hours for all charts in one row.

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
    for (const [value, text] of [
      ["hours", "Hours of the test"],
      ["utc", "UTC"],
      ["local", "Local time"],
    ])
      this.axis.append(el("option", { value, text }));
    this.span = el("span", { class: "quiet small", "aria-live": "polite" });
    this.resetButton = button("Whole test", () => go({ from_h: null, to_h: null }));
    const day = button("Last 24 h", () => {
      // The range includes the set of the current hour.
      const to_h = Math.floor(now()) + 1;
      go({ from_h: Math.max(0, to_h - DAY_H), to_h });
    });
    this.link = copyButton(
      "Copy link",
      () => location.href,
      () => "The link is the page's address: copy it there",
    );
    this.axis.addEventListener("change", () => go({ axis: /** @type {any} */ (this.axis.value) }));
    this.root.append(
      this.over,
      this.relative,
      this.axis,
      day,
      this.resetButton,
      this.span,
      this.link.status,
      this.link.button,
      exportMenu("the test", () => testOffer(this.shown)),
    );
    /** @type {[number, number] | null} */
    this.shown = null;
    this.builtFrom = "";
    this.linked = "";
  }

  /**
   * @param {View} view
   * @param {string} charted
   * @param {any} info
   * @param {import("../timeline.js").Timeline} timeline
   */
  update(view, charted, info, timeline) {
    const positions = info.positions
      .filter((/** @type {any} */ positionInfo) => positionInfo.method === "solitary_wave")
      .map((/** @type {any} */ positionInfo) => positionInfo.position);
    const builtFrom = JSON.stringify([positions, charted, view.compare]);
    if (builtFrom !== this.builtFrom) {
      this.builtFrom = builtFrom;
      const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.compare;
      const buttons = positions
        .filter((/** @type {string} */ position) => position !== charted)
        .map((/** @type {string} */ position) => {
          const chosen = view.compare.includes(position);
          const compare = chosen ? view.compare.filter((one) => one !== position) : [...view.compare, position];
          return button(`Compare ${position}`, () => this.go({ compare }), {
            "aria-pressed": String(chosen),
            "data-compare": position,
          });
        });
      this.over.replaceChildren(...buttons);
      if (focused) /** @type {HTMLElement | null} */ (this.over.querySelector(`[data-compare="${focused}"]`))?.focus();
    }
    this.relative.setAttribute("aria-pressed", String(view.relative));
    this.relative.onclick = () => this.go({ relative: !view.relative });
    this.axis.value = view.axis;
    this.resetButton.disabled = view.from_h === null;
    this.shown = view.from_h === null || view.to_h === null ? null : [view.from_h, view.to_h];
    const text =
      view.from_h === null || view.to_h === null
        ? ""
        : `hour ${fixed(view.from_h, 1)} to ${fixed(view.to_h, 1)}` +
          (timeline.axis === "hours" ? "" : ` · ${timeline.text(view.from_h)} to ${timeline.text(view.to_h)}`);
    setText(this.span, text);
    if (this.linked !== location.href) setText(this.link.status, "");
    this.linked = location.href;
    this.root.hidden = false;
  }
}
