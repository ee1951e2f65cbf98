// The two live connections: events (SSE, resumes by itself) and waveforms (WebSocket, latest only).

const TOPICS = ["sets", "features", "thickness", "verdicts", "alarms", "environment", "service"];

export class EventStream {
  /**
   * @param {{onEvent: (topic: string, event: any) => void, onGap: () => void, onState: (open: boolean) => void}} handlers
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.lastId = 0;
    /** @type {EventSource | null} */
    this.source = null;
  }

  /** @param {number | null} after id of the last event that the page already shows */
  open(after) {
    this.close();
    if (after !== null) this.lastId = after;
    const source = new EventSource(`/api/v1/stream${after === null ? "" : `?after=${after}`}`);
    this.source = source;
    source.onopen = () => this.handlers.onState(true);
    source.onerror = () => {
      this.handlers.onState(false);
      // A refused connection is final to EventSource: try again from where we are.
      if (source.readyState === EventSource.CLOSED && this.source === source) {
        setTimeout(() => this.source === source && this.open(this.lastId), 1000);
      }
    };
    for (const topic of TOPICS) {
      source.addEventListener(topic, (message) => {
        this.lastId = Number(message.lastEventId);
        this.handlers.onEvent(topic, JSON.parse(message.data));
      });
    }
    source.addEventListener("gap", (message) => {
      this.lastId = Number(message.lastEventId);
      this.handlers.onGap();
    });
    source.addEventListener("bye", () => this.handlers.onState(false));
  }

  close() {
    this.source?.close();
    this.source = null;
  }
}

/**
 * @typedef {object} Record_
 * @property {any} header
 * @property {Float64Array} volts
 * @property {Float64Array} micros time from the trigger in µs
 */

/** @param {ArrayBuffer} buffer @returns {Record_} */
export function decode(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const Samples = header.dtype === "int32" ? Int32Array : Int16Array;
  const counts = new Samples(buffer, 4 + length);
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

export class WaveformStream {
  /** @param {(record: Record_) => void} onRecord */
  constructor(onRecord) {
    this.onRecord = onRecord;
    this.position = "";
    this.delayMs = 500;
    /** @type {WebSocket | null} */
    this.socket = null;
    // A hidden tab needs no pictures.
    document.addEventListener("visibilitychange", () => (document.hidden ? this.close() : this.open(this.position)));
  }

  /** @param {string} position */
  open(position) {
    this.close();
    this.position = position;
    if (!position || document.hidden) return;
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/api/v1/waveforms/live?positions=${position}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => (this.delayMs = 500);
    socket.onmessage = (message) => {
      if (this.socket === socket) this.onRecord(decode(message.data));
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
    // Closing while it connects would complain on the console.
    if (socket?.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close();
    else socket?.close();
  }
}
