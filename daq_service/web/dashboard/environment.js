// Show supply and climate around the newest set, and the supply now, each with quality and age.

import { el } from "./dom.js";
import { fixed, hour, quantity } from "./format.js";
import { chip } from "./icons.js";

/** @type {Record<string, import("./icons.js").Look>} */
const QUALITIES = {
  good: { label: "Good", icon: "check", tone: "good" },
  suspect: { label: "Suspect", icon: "triangle", tone: "warn" },
  stale: { label: "Stale", icon: "triangle", tone: "warn" },
  no_communication: { label: "No communication", icon: "link", tone: "alarm" },
};

/** Format a current at the scale of the electrochemical supply. @param {number | null} current_a */
function current(current_a) {
  return current_a !== null && Math.abs(current_a) >= 1
    ? quantity(current_a, 1, 3, "A")
    : quantity(current_a, 1e3, 2, "mA");
}

/**
 * @param {string} name
 * @param {string} quality
 * @param {number | null} age_s
 * @param {[string, string][]} values
 * @param {string} since
 */
function group(name, quality, age_s, values, since = "before") {
  const qualityLook = QUALITIES[quality] ?? { label: quality, icon: "dash", tone: "" };
  const age = age_s === null ? "" : `read ${fixed(age_s, age_s < 10 ? 1 : 0)} s ${since}`;
  const element = el(
    "div",
    { class: "environment-group", "data-quality": quality },
    el(
      "p",
      { class: "environment-name" },
      el("strong", { text: name }),
      chip(qualityLook),
      el("span", { class: "quiet small", text: age }),
    ),
    el(
      "dl",
      { class: "readouts" },
      ...values.map(([term, value]) => el("div", {}, el("dt", { text: term }), el("dd", { text: value }))),
    ),
  );
  return element;
}

/** Show the output now, also while no recorder runs. @param {any} now */
function supplyNow(now) {
  const output = [
    now.quality === "good" ? now.state : `${now.state}; last reading ${now.last}`,
    ...(now.switch_off_pending ? ["switch-off pending, output may be ON"] : []),
    ...(now.tripped === null ? [] : [`tripped: ${now.tripped}`]),
  ].join("; ");
  return group("Supply (live)", now.quality, now.age_s, [["Output", output]], "ago");
}

/** @param {HTMLElement} root @param {any} answer of /environment/latest */
export function showEnvironment(root, answer) {
  const row = answer.latest;
  root.hidden = row === null && answer.supply_now === null;
  if (root.hidden) return;
  const parts = [el("h2", { id: "environment-title", class: "sr-only", text: "Supply and climate" })];
  if (answer.supply_now !== null) parts.push(supplyNow(answer.supply_now));
  if (row === null) return root.replaceChildren(...parts);
  if (row.supply_quality !== "absent") {
    const state =
      row.supply_tripped === null ? row.supply_state : `${row.supply_state}, tripped: ${row.supply_tripped}`;
    parts.push(
      group("Supply", row.supply_quality, row.supply_age_s, [
        ["Output", state],
        ["Voltage", quantity(row.voltage_v, 1, 2, "V")],
        ["Current", current(row.current_a)],
        ["Charge", quantity(row.charge_coulomb, 1, 1, "C")],
      ]),
    );
  }
  if (row.climate_quality !== "absent") {
    parts.push(
      group("Climate", row.climate_quality, row.climate_age_s, [
        ["Temperature", quantity(row.temperature_c, 1, 1, "°C")],
        ["Relative humidity", quantity(row.relative_humidity, 100, 0, "%")],
      ]),
    );
  }
  parts.push(
    el("p", {
      class: "quiet small environment-age",
      text: `Set ${row.set_index}, hour ${hour(row.due_h)} · ${fixed(row.age_h, 1)} h old`,
    }),
  );
  root.replaceChildren(...parts);
}
