// One connection to the service's events (SSE): resumes by itself, also after it was refused or is frozen.

import { Watch } from "./heartbeat.js";

const TOPICS = ["sets", "features", "thickness", "verdicts", "alarms", "annotations", "environment", "service"];
const RETRY_MS = 1000;
/** Of the service, unless it states another. */
export const HEARTBEAT_S = 15;

/**
 * @typedef {{topic: string, id: number, event: any}} News
 * @typedef {object} Listener
 * @property {(news: News) => void} onNews
 * @property {(id: number) => void} onGap what came before this id is to be read anew
 * @property {(open: boolean) => void} onState
 */

export class Source {
  /** @param {number} after id of the last event that is known already @param {Listener} listener @param {string} base where the test is */
  constructor(after, listener, base) {
    this.base = base;
    this.lastId = after;
    this.listener = listener;
    this.isOpen = false;
    /** @type {EventSource | null} */
    this.source = null;
    this.watch = new Watch(HEARTBEAT_S, () => this.renew());
    this.wake(true);
  }

  /** Connect from where we are; or let go of the connection for a while. @param {boolean} awake */
  wake(awake) {
    if (awake === (this.source !== null)) return;
    if (awake) return this.connect();
    this.source?.close();
    this.source = null;
    this.watch.rest();
  }

  /** Replace a connection that is silent. */
  renew() {
    this.say(false);
    this.source?.close();
    this.connect();
  }

  connect() {
    this.watch.connecting();
    const source = (this.source = new EventSource(`${this.base}/api/v1/stream?after=${this.lastId}`));
    source.onopen = () => this.alive();
    source.addEventListener("heartbeat", (message) => this.alive(JSON.parse(message.data).interval_s));
    source.onerror = () => {
      this.say(false);
      // A refused connection is final to EventSource: try again from where we are.
      if (source.readyState === EventSource.CLOSED) setTimeout(() => this.source === source && this.connect(), RETRY_MS);
    };
    for (const topic of TOPICS) {
      source.addEventListener(topic, (message) => {
        this.lastId = Number(message.lastEventId);
        this.listener.onNews({ topic, id: this.lastId, event: JSON.parse(message.data) });
      });
    }
    source.addEventListener("gap", (message) => {
      this.lastId = Number(message.lastEventId);
      this.listener.onGap(this.lastId);
    });
    source.addEventListener("bye", () => this.say(false));
  }

  /** Take in a sign of life. @param {number} [intervalS] */
  alive(intervalS) {
    this.watch.alive(intervalS);
    this.say(true);
  }

  /** @param {boolean} open */
  say(open) {
    this.isOpen = open;
    this.listener.onState(open);
  }
}
