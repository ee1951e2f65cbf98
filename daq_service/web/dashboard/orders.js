// Orders to the recorder: written over REST, then followed until the recorder has answered.

import { get, post } from "./api.js";

const LOOK_MS = 300;
const LOOKS = 60;

/**
 * Give an order and wait for its answer; events bring what it changes.
 *
 * @param {string} kind @param {object} args
 * @param {(word: string) => void} say what has become of it so far
 */
export async function order(kind, args, say) {
  say("Sending");
  const command = await post("/commands", { kind, author: "dashboard", arguments: args });
  say("Sent");
  for (let look = 0; look < LOOKS; look++) {
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    const row = await get(`/commands/${command.id}`);
    if (row.state === "done") return;
    if (row.state === "refused") throw new Error(row.result ?? `the recorder refused to ${kind}`);
  }
  // The recorder looks between two strikes: one that is storing a set may take a while.
  say("Waiting for the recorder");
}
