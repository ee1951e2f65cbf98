// Send commands to the recorder over REST, and wait until they are answered or have expired.

import { get, post } from "./api.js";
import { authorName } from "./control/session.js";
import { setText } from "./dom.js";

const POLL_MS = 300;
const MAX_POLLS = 600;

/**
 * Send a command and wait for its result; events report what it changes.
 *
 * @param {string} kind @param {object} args
 * @param {(buttonText: string) => void} report receives the status of the command
 */
export async function sendCommand(kind, args, report) {
  const name = await authorName();
  report("Sending");
  await awaitResult(await post("/commands", { kind, author: name, arguments: args }), report);
}

/**
 * Send a command by a button, which shows its status.
 *
 * @param {HTMLButtonElement} button @param {string} kind @param {object} args @param {(text: string) => void} onTrouble
 * @returns {Promise<boolean>} whether it was carried out
 */
export async function sendByButton(button, kind, args, onTrouble) {
  const buttonText = button.textContent ?? "";
  button.disabled = true;
  try {
    await sendCommand(kind, args, (text) => setText(button, text));
    return true;
  } catch (error) {
    onTrouble(/** @type {Error} */ (error).message);
    return false;
  } finally {
    button.disabled = false;
    setText(button, buttonText);
  }
}

/**
 * Wait until the recorder has answered or the command has expired by the service's clock.
 *
 * @param {any} row of /commands @param {(buttonText: string) => void} report
 */
export async function awaitResult(row, report) {
  for (let poll = 0; poll < MAX_POLLS; poll++) {
    if (row.state === "done") return;
    if (row.state === "rejected") throw new Error(row.result ?? `The recorder rejected ${row.kind}.`);
    if (row.state !== "pending" && row.state !== "started") throw new Error(`${row.kind} ${row.state}: ${row.result}`);
    // The recorder reads commands between two strikes: while it stores a set this may take some time.
    report(row.state === "started" ? "Executing" : `Sent, expires in ${Math.ceil(row.expires_in_s)} s`);
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
    row = await get(`/commands/${row.id}`);
  }
  throw new Error(`${row.kind}: started, no result yet. Check the state before you send it again.`);
}
