// Mark sets on the waterfall: where their pulses were found, and which of them are bad.

/** @typedef {{field: string, label: string, color: string, dash: number[]}} Track */

const TRACKS = /** @type {Record<string, Track[]>} */ ({
  solitary_wave: [
    { field: "isw_time_s", label: "ISW", color: "--ink", dash: [] },
    { field: "psw_time_s", label: "PSW", color: "--good", dash: [8, 3] },
    { field: "ssw_time_s", label: "SSW", color: "--second", dash: [3, 3] },
  ],
  pulse_echo: [{ field: "travel_time_s", label: "first echo", color: "--ink", dash: [] }],
});

/** Return the columns of /trends that the tracks need. @param {string} method @returns {string[]} */
export function fieldsOf(method) {
  return TRACKS[method].map(({ field }) => field);
}

/**
 * Return the tracks in the time of the image; a pulse that was never found has none.
 *
 * @param {any} header
 * @param {Record<string, any[]>} columns
 */
export function tracksOf({ method, align }, columns) {
  const [{ field: anchor }] = TRACKS[method];
  const from = (/** @type {number} */ k) => (align === "trigger" ? 0 : columns[anchor][k]);
  return TRACKS[method]
    .filter(({ field }) => columns[field].some((/** @type {number | null} */ one) => one !== null))
    .map((track) => ({
      ...track,
      hours: columns.due_h,
      seconds: columns[track.field].map((/** @type {number | null} */ time, /** @type {number} */ k) =>
        time === null || from(k) === null ? null : time - from(k),
      ),
    }));
}

/** Return the hours of bad sets. @param {Record<string, any[]>} columns @returns {number[]} */
export function badHoursOf({ due_h, quality }) {
  return due_h.filter((_, k) => quality[k] === "bad");
}
