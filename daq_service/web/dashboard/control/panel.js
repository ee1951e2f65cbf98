// Offer the commands that change the test for good: stop, disable, supply. Disabled, with the reason, where the role
// does not allow them.

import { byId, el, setText } from "../dom.js";
import { duration, significant } from "../format.js";
import { sendByButton } from "../commands.js";
import { askConfirmation } from "./confirm.js";
import { isAllowed, denialReason } from "./session.js";

/** @typedef {import("./confirm.js").Question} Question */

const NOTE = { name: "note", label: "Reason (everybody sees it)" };

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
    `It goes off by the command below, at ${significant(supply.interlock_current_a)} A or more ` +
    `(interlock),${endText} and ${duration(supply.watchdog_timeout_s)} after the recorder is gone. Once off ` +
    "it never goes on again by itself."
  );
}

/** @type {Record<string, (info: any, position: string) => Question>} */
const QUESTIONS = {
  stop: ({ supply }) => ({
    title: "Stop the test",
    paragraphs: [
      "The recorder ends after the shot that is being taken. From then on nothing is recorded: sets " +
        "that fall due are missed, and what is stored stays.",
      ...(supply === null
        ? []
        : [
            supply.off_at_end
              ? "The supply is switched off, and does not go on again by itself."
              : "The supply stays as it is. Its watchdog switches it off after " +
                `${duration(supply.watchdog_timeout_s)} without a recorder.`,
          ]),
      "This page cannot take it back: to go on, somebody starts `solimon run` at the computer.",
    ],
    submitLabel: "Stop the test",
  }),
  disable: (_, position) => ({
    title: `Disable position ${position}`,
    paragraphs: [
      `Position ${position} is not struck from its next shot on. No sets will come from it, and what ` +
        "falls due meanwhile cannot be made up for; the other positions go on.",
      "It stays so over restarts. To undo it, press Enable next to its notice.",
    ],
    submitLabel: `Disable ${position}`,
    fields: [NOTE],
  }),
  supply_on: ({ supply }) => ({
    title: "Switch the supply on",
    paragraphs: [
      "The wall corrodes and the cell makes hydrogen for as long as the supply is on: air the tank, and " +
        "keep hands out of it. Corrosion cannot be taken back.",
      supplyEndText(supply),
      `At most ${significant(supply.voltage_cap_v)} V and ${significant(supply.current_cap_a)} A are ` +
        "allowed. If it is on already, it takes over these values.",
    ],
    submitLabel: ({ voltage_v, current_limit_a }) => `Switch on: ${voltage_v} V, at most ${current_limit_a} A`,
    fields: [
      number("voltage_v", "Voltage in V", supply.voltage_v, supply.voltage_cap_v),
      number("current_limit_a", "Current limit in A", supply.current_limit_a, supply.current_cap_a),
      NOTE,
    ],
  }),
  supply_off: () => ({
    title: "Switch the supply off",
    paragraphs: [
      "Corrosion ends. The supply stays off, over restarts too, until somebody switches it on here or " +
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
    this.offer("stop", "Stop the test");
    for (const { position, method } of info.positions)
      if (method === "solitary_wave") this.offer("disable", `Disable ${position}`, position, disabled.has(position));
    if (info.supply !== null) {
      this.offer("supply_on", "Supply on, or its limits");
      this.offer("supply_off", "Supply off");
    }
    setText(byId("control-reason"), Object.keys(QUESTIONS).every(isAllowed) ? "" : denialReason());
  }

  /** @param {string} kind @param {string} label @param {string} [position] @param {boolean} [hidden] */
  offer(kind, label, position = "", hidden = false) {
    const key = `${kind} ${position}`;
    let button = this.buttons.get(key);
    if (!button) {
      button = /** @type {HTMLButtonElement} */ (
        el("button", {
          class: "button ghost",
          type: "button",
          disabled: !isAllowed(kind),
          "aria-describedby": "control-reason",
          text: label,
        })
      );
      button.addEventListener("click", () => void this.ask(kind, position, /** @type {HTMLButtonElement} */ (button)));
      this.buttons.set(key, button);
      this.choices.append(button);
    }
    button.hidden = hidden;
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
