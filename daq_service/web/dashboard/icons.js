// Draw icons; each state has its own shape, so that color is never the only sign.

const SVG = "http://www.w3.org/2000/svg";

/** @type {Record<string, string>} */
const PATHS = {
  check: "M3 8.5l3.2 3.2L13 4.8",
  dots: "M3.5 8h.01M8 8h.01M12.5 8h.01",
  triangle: "M8 2.5L14.2 13H1.8zM8 6.5v3M8 11.3h.01",
  bell: "M4 11V7.2a4 4 0 0 1 8 0V11l1.2 1.6H2.8zM6.6 14.2h2.8M8 1.6v1.2",
  stop: "M8 1.8a6.2 6.2 0 1 0 0 12.4a6.2 6.2 0 1 0 0-12.4M3.8 12.2L12.2 3.8",
  dash: "M3 8h10",
  link: "M2 8a6 6 0 0 1 12 0M4.6 9.5a3.4 3.4 0 0 1 6.8 0M8 11.8h.01",
  pause: "M5.6 2.6v10.8M10.4 2.6v10.8",
  flag: "M4 14.2V2.2M4 3h8.2L10.2 6l2 3H4",
};

/** @param {string} name @returns {SVGSVGElement} */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  for (const [key, value] of Object.entries({
    viewBox: "0 0 16 16",
    width: "14",
    height: "14",
    fill: "none",
    stroke: "currentColor",
    "stroke-width": name === "dots" ? "2.6" : "1.8",
    "stroke-linecap": "round",
    "stroke-linejoin": "round",
    "aria-hidden": "true",
  })) {
    svg.setAttribute(key, value);
  }
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", PATHS[name] ?? PATHS.dash);
  svg.append(path);
  return svg;
}

/** @typedef {{label: string, icon: string, tone: string}} Look */

/** @type {Record<string, Look>} */
export const STATES = {
  no_data: { label: "No data", icon: "dash", tone: "" },
  collecting_baseline: { label: "Collecting baseline", icon: "dots", tone: "info" },
  not_assessed: { label: "Not assessed", icon: "triangle", tone: "warn" },
  normal: { label: "Normal", icon: "check", tone: "good" },
  outlier: { label: "Outlier", icon: "triangle", tone: "warn" },
  shelved: { label: "Shelved", icon: "pause", tone: "warn" },
  out_of_service: { label: "Out of service", icon: "pause", tone: "warn" },
  alarm: { label: "Alarm", icon: "bell", tone: "alarm" },
  disabled: { label: "Disabled", icon: "stop", tone: "alarm" },
};

/** @type {Record<string, Look>} */
export const RECORDER = {
  running: { label: "Live", icon: "check", tone: "good" },
  finished: { label: "Test finished", icon: "flag", tone: "info" },
  stopped: { label: "Recorder stopped", icon: "stop", tone: "warn" },
  not_responding: { label: "Recorder not responding", icon: "triangle", tone: "alarm" },
  not_started: { label: "Recorder not started", icon: "triangle", tone: "warn" },
};

/** @type {Record<string, Look>} */
export const PRIORITIES = {
  critical: { label: "Critical", icon: "bell", tone: "alarm" },
  high: { label: "High", icon: "bell", tone: "alarm" },
  medium: { label: "Medium", icon: "triangle", tone: "warn" },
  low: { label: "Low", icon: "flag", tone: "info" },
};

/** @param {Look} state @param {string} [kind] */
export function chip(state, kind = "chip") {
  const element = document.createElement("span");
  element.className = kind;
  element.dataset.tone = state.tone;
  element.append(icon(state.icon), state.label);
  return element;
}
