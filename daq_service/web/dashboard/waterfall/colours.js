// A diverging colour map, blue below zero and orange above: the pair that every kind of colour vision tells
// apart. Lightness rises or falls evenly from zero, so that it reads in grey, too.

const STEPS = 127;
/** From zero outwards, below and above it. @type {Record<string, {below: number[][], above: number[][]}>} */
const MAPS = {
  light: { below: [[255, 255, 255], [120, 178, 222], [0, 82, 148], [0, 30, 66]], above: [[255, 255, 255], [244, 176, 104], [186, 84, 0], [84, 26, 0]] },
  dark: { below: [[13, 19, 24], [0, 78, 130], [64, 160, 222], [200, 232, 255]], above: [[13, 19, 24], [128, 56, 0], [236, 140, 48], [255, 232, 196]] },
};

/** @param {number[][]} stops @param {number} part 0 to 1 @returns {number[]} */
function between(stops, part) {
  const at = Math.min(part * (stops.length - 1), stops.length - 1 - 1e-9);
  const k = Math.floor(at);
  return stops[k].map((value, channel) => Math.round(value + (at - k) * (stops[k + 1][channel] - value)));
}

/** @param {"light" | "dark"} theme @returns {Uint32Array} of 2 STEPS + 1 pixels as canvases keep them, zero in the middle */
export function palette(theme) {
  const pixels = new Uint8ClampedArray(4 * (2 * STEPS + 1));
  for (let k = -STEPS; k <= STEPS; k++) pixels.set([...between(MAPS[theme][k < 0 ? "below" : "above"], Math.abs(k) / STEPS), 255], 4 * (k + STEPS));
  return new Uint32Array(pixels.buffer);
}

/** Which colour of the palette a value has. @param {number} value @param {number} limit the greatest magnitude */
export function step(value, limit) {
  return STEPS + Math.round(STEPS * Math.max(-1, Math.min(1, limit > 0 ? value / limit : 0)));
}

/** Which theme is shown. @returns {"light" | "dark"} */
export function themeNow() {
  const chosen = document.documentElement.dataset.theme;
  if (chosen === "light" || chosen === "dark") return chosen;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}
