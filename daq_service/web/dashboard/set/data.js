// Read all data of one set of one position from the API.

import { get } from "../api.js";
import { setName } from "../format.js";
import { readWaveforms } from "./waveforms.js";

/**
 * @typedef {object} SetData
 * @property {any} set row of the set; null: there is none yet
 * @property {any[]} shots
 * @property {any} feature of the set: solitary wave or thickness; null: none
 * @property {any[]} shotFeatures features of single shots
 * @property {any} assessment
 * @property {any} baseline that the assessment refers to
 * @property {any} environment
 * @property {{header: any, waveforms: import("./waveforms.js").Waveform[]} | null} waveforms
 * @property {string} missingReason why waveforms are not shown; empty: they are
 */

/** @param {string} path @returns {Promise<any[]>} */
const items = async (path) => (await get(path)).items;

/**
 * @param {string} position @param {"solitary_wave" | "pulse_echo"} method @param {import("../format.js").SetKey} key
 * @returns {Promise<SetData>}
 */
export async function readSetData(position, method, key) {
  const waves = method === "solitary_wave";
  const which = `position=${position}&set_index=${key}`;
  const [set] = await items(`/sets?${which}`);
  /** @type {SetData} */
  const nothing = {
    set: set ?? null,
    shots: [],
    feature: null,
    shotFeatures: [],
    assessment: null,
    baseline: null,
    environment: null,
    waveforms: null,
    missingReason: "",
  };
  if (!set) return { ...nothing, missingReason: `Position ${position} has no ${setName(key)} yet.` };
  const taken = set.n_taken > 0;
  const [features, shotFeatures, [assessment], baselines, environment, shots, waveforms] = await Promise.all([
    items(waves ? `/features?${which}&scope=set` : `/thickness?${which}`),
    waves ? items(`/features?${which}&scope=shot&limit=1000`) : [],
    items(`/assessments?${which}`),
    items(`/baselines?position=${position}`),
    items(`/environment?from_h=${set.due_h}&to_h=${set.due_h + 1e-6}`),
    taken ? items(`/sets/${position}/${key}/shots`) : [],
    // A set without a file is not requested: a browser reports each 404 as an error.
    taken && set.file ? readWaveforms(position, key).catch((/** @type {Error} */ error) => error) : null,
  ]);
  const failed = waveforms instanceof Error;
  const reason = failed
    ? `The waveforms cannot be read: ${waveforms.message}`
    : set.reason
      ? `No waveform: ${set.reason}.`
      : "No file of this set is stored.";
  return {
    set,
    shots,
    feature: features[0] ?? null,
    shotFeatures,
    assessment: assessment ?? null,
    baseline: baselines.find((one) => one.id === assessment?.baseline_id) ?? null,
    environment: environment.find((row) => row.set_index === key) ?? null,
    waveforms: failed ? null : waveforms,
    missingReason: waveforms === null || failed ? reason : "",
  };
}
