// Orders to the recorder: written over REST, then followed until they are answered or have expired.

import { get, post } from "./api.js";
import { author } from "./control/session.js";
import { setText } from "./dom.js";

const LOOK_MS = 300;
const LOOKS = 600;

/**
 * Give an order and wait for its answer; events bring what it changes.
 *
 * @param {string} kind @param {object} args
 * @param {(word: string) => void} say what has become of it so far
 */
export async function order(kind, args, say) {
  const name = await author();
  say("Sending");
  await follow(await post("/commands", { kind, author: name, arguments: args }), say);
}

/**
 * Give an order by a button, which tells what has become of it so far.
 *
 * @param {HTMLButtonElement} button @param {string} kind @param {object} args @param {(text: string) => void} onTrouble
 * @returns {Promise<boolean>} it was carried out
 */
export async function giveBy(button, kind, args, onTrouble) {
  const word = button.textContent ?? "";
  button.disabled = true;
  try {
    await order(kind, args, (text) => setText(button, text));
    return true;
  } catch (error) {
    onTrouble(/** @type {Error} */ (error).message);
    return false;
  } finally {
    button.disabled = false;
    setText(button, word);
  }
}

/**
 * Until the recorder has answered, or nobody will any more; the deadline is counted by the service's clock.
 *
 * @param {any} row of /commands @param {(word: string) => void} say
 */
export async function follow(row, say) {
  for (let look = 0; look < LOOKS; look++) {
    if (row.state === "done") return;
    if (row.state === "refused") throw new Error(row.result ?? `the recorder refused to ${row.kind}`);
    if (row.state !== "pending" && row.state !== "started") throw new Error(`${row.kind} ${row.state}: ${row.result}`);
    // The recorder looks between two strikes: one that is storing a set may take a while.
    say(row.state === "started" ? "Being carried out" : `Sent, expires in ${Math.ceil(row.expires_in_s)} s`);
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    row = await get(`/commands/${row.id}`);
  }
  throw new Error(`the recorder began to ${row.kind} and has not answered; look before you order it again`);
}
