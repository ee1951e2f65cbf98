// The same picture as a table: of each row its extremes and where the greatest lies.

import { el } from "../dom.js";
import { fixed } from "../format.js";
import { setsOf } from "./labels.js";

const LONGEST = 200;

/** @param {import("./image.js").Picture} picture @param {(set: number) => void} open @returns {HTMLElement} */
export function tableOf({ header, least: lows, greatest: highs }, open) {
  const unit = header.unit === "V" ? " (V)" : "";
  const head = el("tr", {}, ...["Hour", "Sets", `Least${unit}`, `Greatest${unit}`, "Greatest at (µs)"].map((text) => el("th", { scope: "col", text })));
  const body = el("tbody");
  for (let row = header.rows - 1; row >= Math.max(0, header.rows - LONGEST); row--) {
    let [least, greatest, at] = [Infinity, -Infinity, 0];
    for (let column = 0; column < header.columns; column++) {
      const cell = row * header.columns + column;
      if (lows[cell] < least) least = lows[cell];
      if (highs[cell] > greatest) [greatest, at] = [highs[cell], header.first_s + (column + 0.5) * header.cell_s];
    }
    const hour = fixed(header.first_h[row], 1);
    const opens = el("button", { class: "link", type: "button", text: hour, "aria-label": `Open the set of hour ${hour}` });
    opens.addEventListener("click", () => open(header.first_set[row]));
    const texts = [setsOf(header, row), fixed(least, 3), fixed(greatest, 3), fixed(Number.isFinite(greatest) ? 1e6 * at : null, 1)];
    body.append(el("tr", {}, el("td", {}, opens), ...texts.map((text) => el("td", { text }))));
  }
  const caption = el("caption", { text: `Waterfall: ${header.rows > LONGEST ? `the newest ${LONGEST} of ` : ""}${header.rows} rows, newest first` });
  return el("table", {}, caption, el("thead", {}, head), body);
}
