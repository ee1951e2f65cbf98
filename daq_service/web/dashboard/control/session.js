// Know the user: the name of the token, or an unverified name that this browser remembers.

import { byId, setText } from "../dom.js";
import { askConfirmation } from "./confirm.js";

/** @typedef {{token_needed: boolean, name: string | null, role: string | null, may: string[]}} Session */

const NAME_KEY = "solimon-name";
/** @type {Session} */
let session = { token_needed: false, name: null, role: null, may: [] };

/** @param {Session} loaded by the service */
export function startSession(loaded) {
  session = loaded;
  const button = byId("name");
  button.hidden = session.token_needed;
  button.addEventListener("click", () => void askName());
  showName();
}

/** @param {string} action operation or kind of command, as named in the service's table of roles */
export function isAllowed(action) {
  return session.may.includes(action);
}

/** Return the reason why an action is not allowed. */
export function denialReason() {
  return `${session.name} is ${session.role}: this role does not allow it.`;
}

/**
 * Return the author of a command; ask for the name once where no token has it.
 *
 * @returns {Promise<string>}
 */
export async function authorName() {
  const name = session.name ?? localStorage.getItem(NAME_KEY) ?? (await askName());
  if (!name) throw new Error("Command not sent: it needs the name of its author.");
  return name;
}

async function askName() {
  const answers = await askConfirmation({
    title: "Set name",
    paragraphs: [
      "Commands and the audit log show this name as claimed. Without tokens it is not verified.",
      "This browser stores the name.",
    ],
    submitLabel: "Set name",
    fields: [
      {
        name: "name",
        label: "Name",
        first: true,
        input: { required: true, maxlength: "80", pattern: ".*\\S.*", value: localStorage.getItem(NAME_KEY) ?? "" },
      },
    ],
  });
  if (answers) localStorage.setItem(NAME_KEY, answers.name);
  showName();
  return answers?.name ?? null;
}

function showName() {
  const name = localStorage.getItem(NAME_KEY);
  setText(byId("name"), name ? `${name} (claimed)` : "Set name");
}
