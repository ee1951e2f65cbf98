// List the other tests drawn over this one, each with its state and age, and add another.

import { byId, el, setText } from "../dom.js";
import { ageText } from "../format.js";
import { RECORDER, STATES, chip } from "../icons.js";
import { isOther, nameOf } from "./other-tests.js";
import { swatch } from "./legend.js";

const TICK_MS = 1000;

export class Comparison {
  /**
   * @param {import("./other-tests.js").OtherTests} others
   * @param {(part: Partial<import("../view.js").View>) => void} go
   */
  constructor(others, go) {
    this.others = others;
    this.go = go;
    this.root = byId("others");
    this.list = el("ul", { class: "compared" });
    this.choice = /** @type {HTMLSelectElement} */ (
      el("select", { class: "field small", "aria-label": "Draw a series of another test" })
    );
    this.root.append(this.choice, this.list);
    /** @type {string[]} */
    this.compare = [];
    this.builtFrom = "";
    this.choice.addEventListener(
      "change",
      () => this.choice.value && go({ compare: [...this.compare, this.choice.value] }),
    );
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @param {import("../view.js").View} view */
  update(view) {
    this.compare = view.compare;
    const chosen = view.compare.filter(isOther);
    const { others } = this;
    this.root.hidden = !others.items.length && !chosen.length;
    const states = chosen.map((entry) => [
      entry,
      others.testOf(entry)?.standing?.recorder,
      others.positionInfo(entry)?.state,
      others.errors.get(entry),
    ]);
    const offered = others.items
      .filter((item) => item.standing)
      .map((item) => [
        item.test,
        item.name,
        item.standing.positions.map((/** @type {any} */ positionInfo) => [positionInfo.position, positionInfo.label]),
      ]);
    const builtFrom = JSON.stringify([states, offered]);
    if (builtFrom !== this.builtFrom) {
      this.builtFrom = builtFrom;
      this.offer(offered, chosen);
      this.list.replaceChildren(...chosen.map((entry) => this.row(entry)));
    }
    this.tick();
  }

  /** @param {any[]} offered @param {string[]} chosen */
  offer(offered, chosen) {
    const groups = offered.map(([test, name, positions]) => {
      const options = positions.map((/** @type {string[]} */ [position, label]) => ({
        value: `${test}:${position}`,
        text: `${position} · ${label}`,
      }));
      return el(
        "optgroup",
        { label: `${name} (${test})` },
        ...options
          .filter((/** @type {{value: string}} */ { value }) => !chosen.includes(value))
          .map((/** @type {{value: string, text: string}} */ option) => el("option", option)),
      );
    });
    this.choice.replaceChildren(el("option", { value: "", text: "Compare another test …" }), ...groups);
    this.choice.value = "";
  }

  /** @param {string} entry */
  row(entry) {
    const { others } = this;
    const positionInfo = others.positionInfo(entry);
    const removeButton = el("button", {
      class: "button ghost small",
      type: "button",
      text: "Remove",
      "aria-label": `Remove ${nameOf(entry)}`,
    });
    removeButton.addEventListener("click", () => {
      this.choice.focus();
      this.go({ compare: this.compare.filter((one) => one !== entry) });
    });
    const row = el("li", {}, swatch("--ink", "line", [5, 4]), el("strong", { text: nameOf(entry) }));
    row.dataset.entry = entry;
    if (positionInfo)
      row.append(chip(STATES[positionInfo.state]), chip(RECORDER[others.testOf(entry).standing.recorder]));
    row.append(el("span", { class: "quiet small compared-age" }), removeButton);
    return row;
  }

  tick() {
    for (const row of this.list.children) {
      const entry = /** @type {HTMLElement} */ (row).dataset.entry ?? "";
      const { others } = this;
      const [listed, positionInfo] = [others.testOf(entry), others.positionInfo(entry)];
      const age = positionInfo
        ? ageText(listed.standing, positionInfo, listed.looked_age_s + (performance.now() - others.readAt) / 1000)
        : "";
      const trouble = others.errors.get(entry);
      setText(
        /** @type {Element} */ (row.querySelector(".compared-age")),
        [age, trouble && `not updating: ${trouble}`].filter(Boolean).join(" · ") || "Loading",
      );
    }
  }
}
