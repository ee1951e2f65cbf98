// Filter the alarm list by state, priority, position and kind.

import { el } from "./dom.js";

/** @type {Record<string, [string, (alarm: any, changed: Set<number>) => boolean]>} */
const STATES = {
  all: ["All states", () => true],
  active: ["Active", (alarm) => alarm.state !== "normal" && !alarm.suppressed],
  waiting: ["Unacknowledged", (alarm) => alarm.state === "unacknowledged" || alarm.state === "returned_unacknowledged"],
  suppressed: ["Shelved or out of service", (alarm) => Boolean(alarm.suppressed)],
  visit: ["Since my last visit", (alarm, changed) => changed.has(alarm.id)],
  normal: ["Returned to normal", (alarm) => alarm.state === "normal"],
};
const ALL = "";

export class AlarmFilter {
  /** @param {() => void} onChange */
  constructor(onChange) {
    const select = (/** @type {string} */ label) => {
      const made = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": label }));
      made.addEventListener("change", onChange);
      return made;
    };
    this.state = select("Alarms by state");
    this.state.append(...Object.entries(STATES).map(([value, [text]]) => el("option", { value, text })));
    this.by = {
      priority: select("Alarms by priority"),
      position: select("Alarms by position"),
      kind: select("Alarms by kind"),
    };
    this.root = el(
      "div",
      { class: "alarm-filter", role: "group", "aria-label": "Filter of the alarm list" },
      this.state,
      ...Object.values(this.by),
    );
    this.offered = "";
  }

  /** Offer what there is. @param {any[]} alarms */
  offer(alarms) {
    const found = Object.fromEntries(
      Object.keys(this.by).map((name) => [name, [...new Set(alarms.map((alarm) => alarm[name] ?? "System"))].sort()]),
    );
    if (JSON.stringify(found) === this.offered) return;
    this.offered = JSON.stringify(found);
    for (const [name, select] of Object.entries(this.by)) {
      const { value } = select;
      select.replaceChildren(
        el("option", {
          value: ALL,
          text: { priority: "Priority", position: "Position", kind: "Kind" }[name] ?? name,
        }),
        ...found[name].map((one) => el("option", { value: one, text: one.replaceAll("_", " ") })),
      );
      select.value = found[name].includes(value) ? value : ALL;
    }
  }

  /** @param {any} alarm @param {Set<number>} changed alarms with a change since the last visit */
  shows(alarm, changed) {
    return (
      STATES[this.state.value][1](alarm, changed) &&
      Object.entries(this.by).every(([name, { value }]) => value === ALL || (alarm[name] ?? "System") === value)
    );
  }
}
