// Everything that is known of one set of one position, from the API.

import { get } from "../api.js";
import { setName } from "../format.js";
import { readRecords } from "./waveforms.js";

/**
 * @typedef {object} Evidence
 * @property {any} set its row; null: there is none yet
 * @property {any[]} shots
 * @property {any} feature of the set: solitary wave or thickness; null: none
 * @property {any[]} ofShots features of single shots
 * @property {any} verdict
 * @property {any} baseline that the verdict refers to
 * @property {any} environment
 * @property {{header: any, records: import("./waveforms.js").Record_[]} | null} stored
 * @property {string} missing why records are not shown; empty: they are
 */

/** @param {string} path @returns {Promise<any[]>} */
const items = async (path) => (await get(path)).items;

/**
 * @param {string} position @param {"solitary_wave" | "pulse_echo"} method @param {number} index
 * @returns {Promise<Evidence>}
 */
export async function readEvidence(position, method, index) {
  const waves = method === "solitary_wave";
  const which = `position=${position}&set_index=${index}${waves ? "&purpose=any" : ""}`;
  const [set] = await items(`/sets?${which}`);
  /** @type {Evidence} */
  const nothing = { set: set ?? null, shots: [], feature: null, ofShots: [], verdict: null, baseline: null, environment: null, stored: null, missing: "" };
  if (!set) return { ...nothing, missing: `Nothing is recorded of ${setName(index)} at position ${position} yet.` };
  const taken = set.n_taken > 0;
  const [features, ofShots, [verdict], baselines, environment, shots, stored] = await Promise.all([
    items(waves ? `/features?${which}&scope=set` : `/thickness?${which}`),
    waves ? items(`/features?${which}&scope=shot&limit=1000`) : [],
    items(`/verdicts?${which}`),
    items(`/baselines?position=${position}`),
    items(`/environment?from_h=${set.due_h}&to_h=${set.due_h + 1e-6}`),
    taken ? items(`/sets/${position}/${index}/shots`) : [],
    // What was never stored is not asked for: a browser reports each 404 as an error.
    taken && set.file ? readRecords(position, index).catch((/** @type {Error} */ error) => error) : null,
  ]);
  const failed = stored instanceof Error;
  const why = failed ? `The records cannot be read: ${stored.message}` : set.cause ? `Nothing was recorded: ${set.cause}.` : "No file of this set is stored.";
  return {
    set,
    shots,
    feature: features[0] ?? null,
    ofShots,
    verdict: verdict ?? null,
    baseline: baselines.find((one) => one.id === verdict?.baseline_id) ?? null,
    environment: environment.find((row) => row.set_index === index) ?? null,
    stored: failed ? null : stored,
    missing: stored === null || failed ? why : "",
  };
}
