// Receive live waveforms (WebSocket, newest only), and decode waveforms from bytes.

import { BASE } from "./api.js";
import { HEARTBEAT_S } from "./events/source.js";
import { HeartbeatMonitor } from "./events/heartbeat.js";

/**
 * @typedef {object} Waveform
 * @property {any} header
 * @property {Float64Array} volts
 * @property {Float64Array} micros time from the trigger in µs
 */

/**
 * @param {ArrayBuffer} buffer
 * @returns {{header: any, start: number}} the JSON header, and the byte where the samples start
 */
export function readHeader(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  return { header: JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length))), start: 4 + length };
}

/**
 * @param {ArrayBuffer} buffer
 * @param {number} start
 * @param {any} header dtype, scale and clock of the samples
 * @param {number} [length]
 */
export function toWaveform(buffer, start, header, length) {
  const counts = new (header.dtype === "int32" ? Int32Array : Int16Array)(buffer, start, length);
  const volts = new Float64Array(counts.length);
  const micros = new Float64Array(counts.length);
  const polynomial = header.coefficients_v;
  for (let i = 0; i < counts.length; i++) {
    let value = 0;
    for (let k = polynomial.length - 1; k >= 0; k--) value = value * counts[i] + polynomial[k];
    volts[i] = value;
    micros[i] = ((i - header.pretrigger_samples) / header.sample_rate_hz) * 1e6;
  }
  return { header, volts, micros };
}

/** @param {ArrayBuffer} buffer a live waveform @returns {Waveform} */
export function decode(buffer) {
  const { header, start } = readHeader(buffer);
  return toWaveform(buffer, start, header);
}

export class WaveformStream {
  /** @param {(toWaveform: Waveform) => void} onRecord */
  constructor(onRecord) {
    this.onRecord = onRecord;
    this.position = "";
    this.delayMs = 500;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.monitor = new HeartbeatMonitor(HEARTBEAT_S, () => {
      // Also a connection that is not open yet: other connections to this service would wait for it.
      this.socket?.close();
      this.open(this.position);
    });
    // A hidden tab needs no waveforms.
    document.addEventListener("visibilitychange", () => (document.hidden ? this.close() : this.open(this.position)));
  }

  /** @param {string} position */
  open(position) {
    this.close();
    this.position = position;
    if (!position || document.hidden) return;
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}${BASE}/api/v1/waveforms/live?positions=${position}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.monitor.connecting();
    socket.onopen = () => {
      this.delayMs = 500;
      this.monitor.beat();
    };
    socket.onmessage = (message) => {
      if (this.socket !== socket) return;
      const heartbeat = typeof message.data === "string";
      this.monitor.beat(heartbeat ? JSON.parse(message.data).interval_s : undefined);
      if (!heartbeat) this.onRecord(decode(message.data));
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.delayMs = Math.min(2 * this.delayMs, 8000);
      setTimeout(() => this.socket === socket && this.open(this.position), this.delayMs);
    };
  }

  close() {
    const socket = this.socket;
    this.socket = null;
    this.monitor.stop();
    // To close it while it connects would write an error to the console.
    if (socket?.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close();
    else socket?.close();
  }
}
