// Draw the pulses of a waveform where they were found.

import { color } from "./dom.js";

export const PULSES = [
  { name: "ISW", long: "incident", time: "isw_time_s", height: "isw_amplitude_v" },
  { name: "PSW", long: "primary reflected", time: "psw_time_s", height: "psw_amplitude_v" },
  { name: "SSW", long: "secondary reflected", time: "ssw_time_s", height: "ssw_amplitude_v" },
];

/** @typedef {{name: string, time_s: number, height_v: number}} Mark */

/** @param {any} found features or marks by name @returns {Mark[]} those that were found */
export function marksOf(found) {
  return PULSES.map(({ name, time, height }) => ({ name, time_s: found[time], height_v: found[height] })).filter(
    ({ time_s, height_v }) => Number.isFinite(time_s) && Number.isFinite(height_v),
  );
}

/** @param {any} u a uPlot over µs and V @param {Mark[]} marks */
export function drawPulses(u, marks) {
  const { ctx, bbox } = u;
  const ratio = devicePixelRatio;
  ctx.save();
  ctx.font = `600 ${12 * ratio}px system-ui, "Liberation Sans", Arial, sans-serif`;
  ctx.textAlign = "center";
  ctx.textBaseline = "bottom";
  for (const { name, time_s, height_v } of marks) {
    const x = u.valToPos(time_s * 1e6, "x", true);
    const y = u.valToPos(height_v, "y", true);
    if (x < bbox.left || x > bbox.left + bbox.width) continue;
    ctx.strokeStyle = color("--fit");
    ctx.fillStyle = color("--fit");
    ctx.lineWidth = 1.5 * ratio;
    ctx.setLineDash([4 * ratio, 4 * ratio]);
    ctx.beginPath();
    ctx.moveTo(x, y);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.arc(x, y, 4 * ratio, 0, 2 * Math.PI);
    ctx.fill();
    ctx.fillStyle = color("--ink");
    ctx.fillText(name, x, Math.max(y - 7 * ratio, 14 * ratio));
  }
  ctx.restore();
}
