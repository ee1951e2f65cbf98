// Keep one connection to the service's events (SSE); it resumes by itself after a refusal or a freeze.

import { HeartbeatMonitor } from "./heartbeat.js";

const TOPICS = ["sets", "features", "thickness", "assessments", "alarms", "annotations", "environment", "service"];
const RETRY_MS = 1000;
/** Interval of the service's heartbeats, unless it states another. */
export const HEARTBEAT_S = 15;

/**
 * @typedef {{topic: string, id: number, event: any}} StreamEvent
 * @typedef {object} Listener
 * @property {(news: StreamEvent) => void} onEvent
 * @property {(id: number) => void} onGap events before this id are lost: read all data again
 * @property {(open: boolean) => void} onState
 */

export class Source {
  /**
   * @param {number} after id of the last event that is known already
   * @param {Listener} listener
   * @param {string} base path of the test
   */
  constructor(after, listener, base) {
    this.base = base;
    this.lastId = after;
    this.listener = listener;
    this.isOpen = false;
    /** @type {EventSource | null} */
    this.source = null;
    this.monitor = new HeartbeatMonitor(HEARTBEAT_S, () => this.reconnect());
    this.wake(true);
  }

  /** Connect after the last event, or close the connection while the page is hidden. @param {boolean} awake */
  wake(awake) {
    if (awake === (this.source !== null)) return;
    if (awake) return this.connect();
    this.source?.close();
    this.source = null;
    this.monitor.stop();
  }

  /** Replace a connection that is silent. */
  reconnect() {
    this.setOpen(false);
    this.source?.close();
    this.connect();
  }

  connect() {
    this.monitor.connecting();
    const source = (this.source = new EventSource(`${this.base}/api/v1/stream?after=${this.lastId}`));
    source.onopen = () => this.onHeartbeat();
    source.addEventListener("heartbeat", (message) => this.onHeartbeat(JSON.parse(message.data).interval_s));
    source.onerror = () => {
      this.setOpen(false);
      // EventSource does not retry a refused connection: connect again after the last event.
      if (source.readyState === EventSource.CLOSED)
        setTimeout(() => this.source === source && this.connect(), RETRY_MS);
    };
    for (const topic of TOPICS) {
      source.addEventListener(topic, (message) => {
        this.lastId = Number(message.lastEventId);
        this.listener.onEvent({ topic, id: this.lastId, event: JSON.parse(message.data) });
      });
    }
    source.addEventListener("gap", (message) => {
      this.lastId = Number(message.lastEventId);
      this.listener.onGap(this.lastId);
    });
    source.addEventListener("bye", () => this.setOpen(false));
  }

  /** Record a heartbeat. @param {number} [intervalS] */
  onHeartbeat(intervalS) {
    this.monitor.beat(intervalS);
    this.setOpen(true);
  }

  /** @param {boolean} open */
  setOpen(open) {
    this.isOpen = open;
    this.listener.onState(open);
  }
}
