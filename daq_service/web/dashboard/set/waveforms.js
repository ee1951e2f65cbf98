// The records of a set as they come in one answer, and their mean.

import { octets } from "../api.js";
import { head, record } from "../streams.js";

/** @typedef {import("../streams.js").Record_} Record_ */

/** @param {string} position @param {number} index @returns {Promise<{header: any, records: Record_[]}>} */
export async function readRecords(position, index) {
  const buffer = await octets(`/sets/${position}/${index}/waveforms`);
  const { header, start } = head(buffer);
  let at = start;
  /** @type {Record_[]} */
  const records = [];
  for (const its of header.records) {
    // int32 samples begin where a multiple of four does only if all are: a copy begins anywhere.
    const bytes = its.n_samples * (its.dtype === "int32" ? 4 : 2);
    records.push(record(buffer.slice(at, at + bytes), 0, its));
    at += bytes;
  }
  return { header, records };
}

/** Mean of records of one length, sample by sample; null: none. @param {Record_[]} records @returns {Float64Array | null} */
export function mean(records) {
  if (!records.length) return null;
  const sum = new Float64Array(records[0].volts.length);
  for (const { volts } of records) for (let i = 0; i < sum.length; i++) sum[i] += volts[i];
  return sum.map((value) => value / records.length);
}
