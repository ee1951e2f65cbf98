// Plot the waveforms of a set: each shot thin, their mean, the baseline as a ghost, marks and windows.

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { attach } from "../charts/gestures.js";
import { clipped } from "../charts/marks.js";
import { axisLook } from "../charts/plot.js";
import { color } from "../dom.js";
import { drawPulses } from "../pulses.js";

/**
 * @typedef {object} Trace
 * @property {string} label
 * @property {Float64Array} volts
 * @property {string} color custom property
 * @property {number} width
 * @property {number[]} [dash]
 * @property {boolean} [faint]
 *
 * @typedef {object} Overlay
 * @property {Float64Array} micros
 * @property {Trace[]} traces the last one on top
 * @property {import("../pulses.js").Mark[]} marks
 * @property {Record<string, [number, number]>} windows_s by name; zero width: an instant
 *
 * @typedef {object} Span
 * @property {() => import("../charts/gestures.js").Span | null} span in µs
 * @property {(span: import("../charts/gestures.js").Span | null) => void} show
 */

/** @param {any} u @param {Overlay["windows_s"]} windows */
function drawWindows(u, windows) {
  const { bbox } = u;
  const ratio = devicePixelRatio;
  clipped(u, (ctx) => {
    ctx.font = `${11 * ratio}px system-ui, "Liberation Sans", Arial, sans-serif`;
    ctx.textBaseline = "top";
    Object.entries(windows).forEach(([name, [from, to]], row) => {
      const left = u.valToPos(from * 1e6, "x", true);
      const width = Math.max(u.valToPos(to * 1e6, "x", true) - left, 1.5 * ratio);
      const top = bbox.top + (4 + 16 * row) * ratio;
      ctx.fillStyle = color("--good-band");
      ctx.fillRect(left, bbox.top, width, bbox.height);
      ctx.fillStyle = color("--good");
      ctx.fillRect(left, top, width, 1.5 * ratio);
      const text = to > from ? `${name} window` : `${name} belongs here`;
      const start = Math.min(
        Math.max(left, bbox.left),
        bbox.left + bbox.width - ctx.measureText(text).width - 4 * ratio,
      );
      ctx.fillText(text, start + 3 * ratio, top + 3 * ratio);
    });
  });
}

/**
 * @param {HTMLElement} box @param {Overlay} overlay @param {Span} host
 * @param {(index: number) => void} onCursor
 */
export function plotWaveforms(box, overlay, host, onCursor) {
  const { micros, traces, marks, windows_s } = overlay;
  const axis = axisLook();
  const full = () => /** @type {import("../charts/gestures.js").Span} */ ([micros[0], micros[micros.length - 1]]);
  const span = () => host.span() ?? full();
  const plot = new uPlot(
    /** @type {any} */ ({
      width: box.clientWidth,
      height: box.clientHeight,
      padding: [18, 12, 0, 0],
      legend: { show: false },
      cursor: { drag: { x: true, y: false, setScale: false }, points: { show: false } },
      scales: {
        x: { time: false, range: span },
        y: {
          range: (/** @type {any} */ _u, /** @type {number} */ min, /** @type {number} */ max) => [
            min - Math.max(0.08 * (max - min), 1e-3),
            max + Math.max(0.12 * (max - min), 1e-3),
          ],
        },
      },
      axes: [
        { ...axis, label: "Time from the trigger (µs)", size: 26, labelSize: 20 },
        { ...axis, label: "Sensor voltage (V)", size: 52, labelSize: 18 },
      ],
      series: [
        {},
        ...traces.map((trace) => ({
          label: trace.label,
          stroke: `${color(trace.color)}${trace.faint ? "70" : ""}`,
          width: trace.width,
          dash: trace.dash,
          points: { show: false },
        })),
      ],
      hooks: {
        drawClear: [(/** @type {any} */ u) => drawWindows(u, windows_s)],
        draw: [(/** @type {any} */ u) => drawPulses(u, marks)],
        setCursor: [(/** @type {any} */ u) => onCursor(u.cursor.idx ?? -1)],
        setSelect: [
          (/** @type {any} */ u) => {
            const { left, width } = u.select;
            if (width < 5) return;
            host.show([u.posToVal(left, "x"), u.posToVal(left + width, "x")]);
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          },
        ],
      },
    }),
    /** @type {any} */ ([micros, ...traces.map((trace) => trace.volts)]),
    box,
  );
  const zoomable = { span, full, show: host.show, center: () => (span()[0] + span()[1]) / 2 };
  return { plot, zoomable, detach: attach(plot.over, zoomable) };
}
