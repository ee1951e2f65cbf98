// Show the most urgent active alarm of the test in one sentence, above everything else.

import { el } from "./dom.js";
import { duration, hour } from "./format.js";
import { PRIORITIES, chip } from "./icons.js";

const ACTIVE = new Set(["unacknowledged", "acknowledged"]);
const RANK = ["critical", "high", "medium", "low"];

/** Return the active alarms that are not suppressed, the most urgent first. @param {any[]} alarms of the API */
export function rankActive(alarms) {
  // Of one priority, a wall that the model diagnoses comes first, an acknowledged alarm last.
  const rank = (/** @type {any} */ alarm) =>
    RANK.indexOf(alarm.priority) +
    (alarm.state === "acknowledged" ? 0.5 : 0) -
    (alarm.evidence?.diagnosis === "wall" ? 0.25 : 0);
  return alarms
    .filter((alarm) => ACTIVE.has(alarm.state) && !alarm.suppressed)
    .sort((a, b) => rank(a) - rank(b) || b.raised_h - a.raised_h);
}

/** @param {any} alarm @param {number} others number of the other active alarms */
function alarmParts(alarm, others) {
  const detected = `, detected at hour ${hour(alarm.raised_h)}. `;
  const parts = [
    chip(PRIORITIES[alarm.priority]),
    el("p", {}, el("strong", { text: alarm.headline }), detected, alarm.action),
  ];
  if (others)
    parts.push(
      el("a", { href: "#alarms", class: "small", text: `${others} more active alarm${others > 1 ? "s" : ""}` }),
    );
  return parts;
}

/** @param {any[]} alarms @param {any[]} items of /transducers @param {string} recorder @param {number} nowH */
function quietParts(alarms, items, recorder, nowH) {
  const hours = items.map((item) => item.data_h).filter((data) => data !== null);
  const newest = Math.max(...hours);
  const stale = recorder !== "finished" && items.some((item) => item.stale);
  const hidden = alarms.filter((alarm) => alarm.suppressed && ACTIVE.has(alarm.state)).length;
  const returned = alarms.filter((alarm) => alarm.state === "returned_unacknowledged").length;
  const text = [
    hidden ? `${hidden} shelved or out of service.` : "",
    returned ? `${returned} returned to normal, unacknowledged.` : "",
    stale ? "Data are stale." : "",
    hours.length ? `Newest set: hour ${hour(newest)}, ${duration(3600 * (nowH - newest))} old.` : "No data yet.",
  ];
  const look = stale || hidden ? { icon: "triangle", tone: "warn" } : { icon: "check", tone: "good" };
  return [chip({ ...look, label: "No active alarm" }), el("p", { text: text.filter(Boolean).join(" ") })];
}

/**
 * @param {HTMLElement} root
 * @param {any[]} alarms of the API @param {any[]} items of /transducers
 * @param {string} recorder status @param {number} nowH hour of the test
 */
export function showHeadline(root, alarms, items, recorder, nowH) {
  const [first, ...others] = rankActive(alarms);
  const parts = first ? alarmParts(first, others.length) : quietParts(alarms, items, recorder, nowH);
  root.dataset.tone = parts[0].dataset.tone;
  // The same text is not replaced: a screen reader and the focus stay where they are.
  if (root.textContent !== parts.map((part) => part.textContent).join("")) root.replaceChildren(...parts);
}
