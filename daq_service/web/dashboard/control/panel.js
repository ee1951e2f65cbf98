// Offer the commands that change the test for good: stop, disable, supply. Disabled, with the reason, where the role
// does not allow them.

import { button, byId, setText } from "../dom.js";
import { duration, significant } from "../format.js";
import { sendByButton } from "../commands.js";
import { askConfirmation } from "./confirm.js";
import { isAllowed, denialReason } from "./session.js";

/** @typedef {import("./confirm.js").Question} Question */

const NOTE = { name: "note", label: "Reason (visible to all)" };

/** @param {string} name @param {string} label @param {number} value @param {number} maximum */
function number(name, label, value, maximum) {
  return {
    name,
    label,
    input: { type: "number", required: true, step: "any", min: "0.001", max: String(maximum), value: String(value) },
  };
}

/** @param {any} supply of /info */
function supplyEndText(supply) {
  const endText = supply.off_at_end ? " at the end of the test," : "";
  return (
    `It switches off by command, at ${significant(supply.interlock_current_a)} A or more ` +
    `(interlock),${endText} and ${duration(supply.watchdog_timeout_s)} after the recorder stops. ` +
    "It never switches on again by itself."
  );
}

/** @type {Record<string, (info: any, position: string) => Question>} */
const QUESTIONS = {
  stop: ({ supply }) => ({
    title: "Stop test",
    paragraphs: [
      "The recorder ends after the current shot. Later sets are missed. Stored data remain.",
      ...(supply === null
        ? []
        : [
            supply.off_at_end
              ? "The supply is switched off. It does not switch on again by itself."
              : "The supply keeps its state. Its watchdog switches it off after " +
                `${duration(supply.watchdog_timeout_s)} without a recorder.`,
          ]),
      "This page cannot undo it. To continue, start `solimon run` at the computer.",
    ],
    submitLabel: "Stop test",
  }),
  disable: (_, position) => ({
    title: `Disable position ${position}`,
    paragraphs: [
      `Position ${position} is not struck after its current shot. No sets come from it until it is ` +
        "enabled. The other positions continue.",
      "It stays disabled after a restart. To undo it, press Enable next to its notice.",
    ],
    submitLabel: `Disable ${position}`,
    fields: [NOTE],
  }),
  supply_on: ({ supply }) => ({
    title: "Switch supply on",
    paragraphs: [
      "While the supply is on, the wall corrodes and the cell produces hydrogen. Ventilate the tank and " +
        "keep hands out of it. Corrosion cannot be undone.",
      supplyEndText(supply),
      `The caps are ${significant(supply.voltage_cap_v)} V and ${significant(supply.current_cap_a)} A. ` +
        "A supply that is already on takes these values.",
    ],
    submitLabel: ({ voltage_v, current_limit_a }) => `Switch on: ${voltage_v} V, limit ${current_limit_a} A`,
    fields: [
      number("voltage_v", "Voltage in V", supply.voltage_v, supply.voltage_cap_v),
      number("current_limit_a", "Current limit in A", supply.current_limit_a, supply.current_cap_a),
      NOTE,
    ],
  }),
  supply_off: () => ({
    title: "Switch supply off",
    paragraphs: [
      "Corrosion ends. The supply stays off, also after a restart, until it is switched on here or " +
        "with `solimon supply --on`.",
    ],
    submitLabel: "Switch off",
    fields: [NOTE],
  }),
};

export class RunControl {
  /** @param {(text: string) => void} onTrouble */
  constructor(onTrouble) {
    this.onTrouble = onTrouble;
    this.root = byId("control");
    this.choices = byId("control-choices");
    /** @type {Map<string, HTMLButtonElement>} by kind and position */
    this.buttons = new Map();
    /** @type {any} */
    this.info = null;
  }

  /** @param {any} info @param {any[]} transducers @param {string} recorder */
  update(info, transducers, recorder) {
    this.info = info;
    const disabled = new Set(
      transducers.filter(({ disabled_reason: reason }) => reason !== null).map((one) => one.position),
    );
    const acceptsCommands = recorder !== "finished" && recorder !== "stopped";
    this.root.hidden = !acceptsCommands;
    this.offer("stop", "Stop test");
    for (const { position, method } of info.positions)
      if (method === "solitary_wave") this.offer("disable", `Disable ${position}`, position, disabled.has(position));
    if (info.supply !== null) {
      this.offer("supply_on", "Supply on or new limits");
      this.offer("supply_off", "Supply off");
    }
    setText(byId("control-reason"), Object.keys(QUESTIONS).every(isAllowed) ? "" : denialReason());
  }

  /** @param {string} kind @param {string} label @param {string} [position] @param {boolean} [hidden] */
  offer(kind, label, position = "", hidden = false) {
    const key = `${kind} ${position}`;
    let offered = this.buttons.get(key);
    if (!offered) {
      offered = button(label, (pressed) => this.ask(kind, position, pressed), {
        class: "button ghost",
        disabled: !isAllowed(kind),
        "aria-describedby": "control-reason",
      });
      this.buttons.set(key, offered);
      this.choices.append(offered);
    }
    offered.hidden = hidden;
  }

  /** @param {string} kind @param {string} position @param {HTMLButtonElement} button */
  async ask(kind, position, button) {
    const answers = await askConfirmation(QUESTIONS[kind](this.info, position));
    if (answers === null) return;
    /** @type {Record<string, string | number>} */
    const values = position ? { position, ...answers } : { ...answers };
    for (const name of ["voltage_v", "current_limit_a"]) if (name in values) values[name] = Number(values[name]);
    await sendByButton(button, kind, values, this.onTrouble);
  }
}
