// Deliver the service's events to this page: from the worker that all tabs share, else by its own connection.

import { BASE } from "../api.js";
import { HEARTBEAT_S, Source } from "./source.js";
import { HeartbeatMonitor } from "./heartbeat.js";

/** Changes with the messages between page and worker: a tab of an older version keeps its own worker. */
const NAME = "solimon-events-3";
/** Missed heartbeats before the worker counts as silent; it detects a frozen connection sooner. */
const MISSED_BEATS = 3;

export class EventStream {
  /**
   * @param {{onEvent: (topic: string, event: any) => void, onGap: () => void, onState: (open: boolean) => void}}
   *   handlers
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.lastId = -1;
    this.started = false;
    /** @type {MessagePort | null} */
    this.port = null;
    /** @type {Source | null} */
    this.direct = null;
    this.monitor = new HeartbeatMonitor(HEARTBEAT_S, () => this.reconnect());
    addEventListener("pagehide", () => this.port?.postMessage({ leave: true }));
    // The browser shows a cached page again: ask for the events since then.
    addEventListener("pageshow", (event) => event.persisted && this.join());
    // Each of several tests has its own connection: hidden pages release theirs for visible ones.
    document.addEventListener("visibilitychange", () => {
      this.port?.postMessage({ awake: this.awake });
      this.direct?.wake(this.awake);
      if (!this.awake) this.monitor.stop();
      else if (this.port) this.monitor.beat(0, MISSED_BEATS);
    });
  }

  get awake() {
    return BASE === "" || !document.hidden;
  }

  join() {
    if (this.port === null) return;
    this.monitor.beat(0, MISSED_BEATS);
    this.port.postMessage({ after: this.lastId, base: BASE, awake: this.awake });
  }

  /** @param {number} after id of the last event that the page already shows */
  open(after) {
    this.lastId = after;
    if (this.started) return;
    this.started = true;
    if (typeof SharedWorker === "undefined") return this.openDirect();
    this.openShared();
  }

  openShared() {
    const worker = new SharedWorker(new URL("./worker.js", import.meta.url), {
      type: "module",
      name: `${NAME} ${BASE}`,
    });
    // A browser that cannot run the worker reports it here.
    worker.onerror = () => this.port !== null && ((this.port = null), this.monitor.stop(), this.openDirect());
    this.port = worker.port;
    this.port.onmessage = ({ data }) => {
      this.monitor.beat(data.intervalS, MISSED_BEATS);
      if (data.news) this.deliver(data.news);
      else if (data.gap !== undefined) this.skip(data.gap);
      else this.handlers.onState(data.open);
    };
    this.join();
  }

  /** Leave a silent worker and connect again, to the same one if it still runs. */
  reconnect() {
    this.handlers.onState(false);
    this.port?.postMessage({ leave: true });
    this.openShared();
  }

  openDirect() {
    this.direct = new Source(
      this.lastId,
      { onEvent: (news) => this.deliver(news), onGap: (id) => this.skip(id), onState: this.handlers.onState },
      BASE,
    );
  }

  /** @param {import("./source.js").StreamEvent} news */
  deliver({ topic, id, event }) {
    if (id <= this.lastId) return;
    this.lastId = id;
    this.handlers.onEvent(topic, event);
  }

  /** @param {number} id */
  skip(id) {
    this.lastId = id;
    this.handlers.onGap();
  }
}
