// Provide a diverging color map, blue below zero and orange above: the pair that every kind of color vision
// distinguishes. Lightness changes evenly from zero, so that it also reads in gray.

const STEPS = 127;
/** Colors from zero outwards, below and above it. @type {Record<string, {below: number[][], above: number[][]}>} */
const MAPS = {
  light: {
    below: [
      [255, 255, 255],
      [120, 178, 222],
      [0, 82, 148],
      [0, 30, 66],
    ],
    above: [
      [255, 255, 255],
      [244, 176, 104],
      [186, 84, 0],
      [84, 26, 0],
    ],
  },
  dark: {
    below: [
      [13, 19, 24],
      [0, 78, 130],
      [64, 160, 222],
      [200, 232, 255],
    ],
    above: [
      [13, 19, 24],
      [128, 56, 0],
      [236, 140, 48],
      [255, 232, 196],
    ],
  },
};

/** @param {number[][]} stops @param {number} fraction 0 to 1 @returns {number[]} */
function interpolate(stops, fraction) {
  const at = Math.min(fraction * (stops.length - 1), stops.length - 1 - 1e-9);
  const k = Math.floor(at);
  return stops[k].map((value, channel) => Math.round(value + (at - k) * (stops[k + 1][channel] - value)));
}

/** @param {"light" | "dark"} theme @returns {Uint32Array} of 2 STEPS + 1 pixels in canvas format, zero in the middle */
export function palette(theme) {
  const pixels = new Uint8ClampedArray(4 * (2 * STEPS + 1));
  for (let k = -STEPS; k <= STEPS; k++)
    pixels.set([...interpolate(MAPS[theme][k < 0 ? "below" : "above"], Math.abs(k) / STEPS), 255], 4 * (k + STEPS));
  return new Uint32Array(pixels.buffer);
}

/** Return the palette index of a value. @param {number} value @param {number} limit the maximum magnitude */
export function step(value, limit) {
  return STEPS + Math.round(STEPS * Math.max(-1, Math.min(1, limit > 0 ? value / limit : 0)));
}

/** Return the theme that is shown. @returns {"light" | "dark"} */
export function themeNow() {
  const chosen = document.documentElement.dataset.theme;
  if (chosen === "light" || chosen === "dark") return chosen;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}
