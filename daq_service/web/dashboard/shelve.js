// Shelve an alarm for a time, or take it out of service until a person returns it; both need a reason.

import { askConfirmation } from "./control/confirm.js";
import { utc } from "./format.js";

/** @type {[string, string][]} */
const DURATIONS = [
  ["8", "8 h"],
  ["1", "1 h"],
  ["24", "24 h"],
  ["72", "72 h"],
];
const REASON = {
  name: "reason",
  label: "Reason",
  first: true,
  input: { required: true, maxlength: "500", pattern: ".*\\S.*" },
};

/** Return how and why an alarm is suppressed; empty: it is not. @param {any} alarm */
export function suppressedText(alarm) {
  if (!alarm.suppressed) return "";
  const state = alarm.suppressed === "shelved" ? `shelved until ${utc(alarm.shelved_until_utc)}` : "out of service";
  const { suppressed_by: author, suppressed_reason: reason } = alarm;
  return `${state} by ${author}: ${reason}`;
}

/** Ask for the arguments of `shelve_alarm`; null: canceled. @param {any} alarm */
export async function askShelving(alarm) {
  const answers = await askConfirmation({
    title: "Shelve alarm",
    paragraphs: [
      alarm.headline,
      "Active but hidden until the time ends or its priority rises.",
      "The time ends by the test clock or in real time, whichever is first.",
    ],
    submitLabel: "Shelve",
    fields: [REASON, { name: "for_h", label: "Duration", options: DURATIONS }],
  });
  return answers && { alarm_id: alarm.id, reason: answers.reason, for_h: Number(answers.for_h) };
}

/** Ask for the arguments of `take_out_of_service`; null: canceled. @param {any} alarm */
export async function askOutOfService(alarm) {
  const answers = await askConfirmation({
    title: "Take alarm out of service",
    paragraphs: [alarm.headline, "Hidden without an end, until a person returns it to service."],
    submitLabel: "Take out of service",
    fields: [REASON],
  });
  return answers && { alarm_id: alarm.id, reason: answers.reason };
}
