// Read the waveforms of a set from one answer, and average them.

import { getBytes } from "../api.js";
import { readHeader, toWaveform } from "../streams.js";

/** @typedef {import("../streams.js").Waveform} Waveform */

/**
 * @param {string} position
 * @param {import("../format.js").SetKey} key
 * @returns {Promise<{header: any, waveforms: Waveform[]}>}
 */
export async function readWaveforms(position, key) {
  const buffer = await getBytes(`/sets/${position}/${key}/waveforms`);
  const { header, start } = readHeader(buffer);
  let at = start;
  /** @type {Waveform[]} */
  const waveforms = [];
  for (const waveformHeader of header.records) {
    // int32 samples may start at a byte that is not a multiple of four: a copy is always aligned.
    const bytes = waveformHeader.n_samples * (waveformHeader.dtype === "int32" ? 4 : 2);
    waveforms.push(toWaveform(buffer.slice(at, at + bytes), 0, waveformHeader));
    at += bytes;
  }
  return { header, waveforms };
}

/**
 * Return the mean of waveforms of one length, sample by sample; null: there are none.
 *
 * @param {Waveform[]} waveforms
 * @returns {Float64Array | null}
 */
export function mean(waveforms) {
  if (!waveforms.length) return null;
  const sum = new Float64Array(waveforms[0].volts.length);
  for (const { volts } of waveforms) for (let i = 0; i < sum.length; i++) sum[i] += volts[i];
  return sum.map((value) => value / waveforms.length);
}
