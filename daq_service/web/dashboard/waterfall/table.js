// Show the waterfall as a table: of each row the extremes and the time of the maximum.

import { el } from "../dom.js";
import { fixed } from "../format.js";
import { setsOf } from "./labels.js";

const MAX_ROWS = 200;

/** @param {import("./image.js").WaterfallImage} image @param {(set: number) => void} open @returns {HTMLElement} */
export function tableOf({ header, minimum: lows, maximum: highs }, open) {
  const unit = header.unit === "V" ? " (V)" : "";
  const head = el(
    "tr",
    {},
    ...["Hour", "Sets", `Minimum${unit}`, `Maximum${unit}`, "Maximum at (µs)"].map((text) =>
      el("th", { scope: "col", text }),
    ),
  );
  const body = el("tbody");
  for (let row = header.rows - 1; row >= Math.max(0, header.rows - MAX_ROWS); row--) {
    let [minimum, maximum, at] = [Infinity, -Infinity, 0];
    for (let column = 0; column < header.columns; column++) {
      const cell = row * header.columns + column;
      if (lows[cell] < minimum) minimum = lows[cell];
      if (highs[cell] > maximum) [maximum, at] = [highs[cell], header.first_s + (column + 0.5) * header.cell_s];
    }
    const hour = fixed(header.first_h[row], 1);
    const openButton = el("button", {
      class: "link",
      type: "button",
      text: hour,
      "aria-label": `Open the set of hour ${hour}`,
    });
    openButton.addEventListener("click", () => open(header.first_set[row]));
    const texts = [
      setsOf(header, row),
      fixed(minimum, 3),
      fixed(maximum, 3),
      fixed(Number.isFinite(maximum) ? 1e6 * at : null, 1),
    ];
    body.append(el("tr", {}, el("td", {}, openButton), ...texts.map((text) => el("td", { text }))));
  }
  const caption = el("caption", {
    text: `Waterfall: ${header.rows > MAX_ROWS ? `the newest ${MAX_ROWS} of ` : ""}${header.rows} rows, newest first`,
  });
  return el("table", {}, caption, el("thead", {}, head), body);
}
