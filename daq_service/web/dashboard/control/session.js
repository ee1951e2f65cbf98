// Who sits here: whom the token names, or a name that this browser remembers and nobody has checked.

import { byId, setText } from "../dom.js";
import { confirmed } from "./confirm.js";

/** @typedef {{token_needed: boolean, name: string | null, role: string | null, may: string[]}} Session */

const NAME_KEY = "solimon-name";
/** @type {Session} */
let session = { token_needed: false, name: null, role: null, may: [] };

/** @param {Session} told by the service */
export function enter(told) {
  session = told;
  const button = byId("name");
  button.hidden = session.token_needed;
  button.addEventListener("click", () => void ask());
  show();
}

/** @param {string} what operation or kind of order, as the service's table of roles calls it */
export function may(what) {
  return session.may.includes(what);
}

/** Why what is not allowed is not. */
export function whyNot() {
  return `${session.name} is ${session.role}: this role does not allow it.`;
}

/**
 * Name that an order bears; asked for once where no token says it.
 *
 * @returns {Promise<string>}
 */
export async function author() {
  const name = session.name ?? localStorage.getItem(NAME_KEY) ?? (await ask());
  if (!name) throw new Error("nothing was sent: an order bears the name of whoever gives it");
  return name;
}

async function ask() {
  const given = await confirmed({
    title: "Your name",
    says: ["Orders and the audit bear it, marked as claimed: without tokens nobody checks it. This browser remembers it."],
    word: "Use this name",
    fields: [{ name: "name", label: "Name", first: true, input: { required: true, maxlength: "80", pattern: ".*\\S.*", value: localStorage.getItem(NAME_KEY) ?? "" } }],
  });
  if (given) localStorage.setItem(NAME_KEY, given.name);
  show();
  return given?.name ?? null;
}

function show() {
  const name = localStorage.getItem(NAME_KEY);
  setText(byId("name"), name ? `${name} (claimed)` : "Say your name");
}
