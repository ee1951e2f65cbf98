// The events of the service, for this page: from the worker that all tabs share, else by its own connection.

import { BASE } from "../api.js";
import { HEARTBEAT_S, Source } from "./source.js";
import { Watch } from "./heartbeat.js";

/** Changes when what is said between page and worker does: a tab of an older version keeps its own. */
const NAME = "solimon-events-3";
/** Heartbeats without a word of the worker, which notices a frozen connection before that. */
const MISSED = 3;

export class EventStream {
  /** @param {{onEvent: (topic: string, event: any) => void, onGap: () => void, onState: (open: boolean) => void}} handlers */
  constructor(handlers) {
    this.handlers = handlers;
    this.lastId = -1;
    this.started = false;
    /** @type {MessagePort | null} */
    this.port = null;
    /** @type {Source | null} */
    this.own = null;
    this.watch = new Watch(HEARTBEAT_S, () => this.renew());
    addEventListener("pagehide", () => this.port?.postMessage({ leave: true }));
    // A page that the browser kept aside comes back: what happened meanwhile is asked for.
    addEventListener("pageshow", (event) => event.persisted && this.join());
    // Each of several tests has a connection of its own: hidden pages leave theirs to those that are looked at.
    document.addEventListener("visibilitychange", () => {
      this.port?.postMessage({ awake: this.awake });
      this.own?.wake(this.awake);
      if (!this.awake) this.watch.rest();
      else if (this.port) this.watch.alive(0, MISSED);
    });
  }

  get awake() {
    return BASE === "" || !document.hidden;
  }

  join() {
    if (this.port === null) return;
    this.watch.alive(0, MISSED);
    this.port.postMessage({ after: this.lastId, base: BASE, awake: this.awake });
  }

  /** @param {number} after id of the last event that the page already shows */
  open(after) {
    this.lastId = after;
    if (this.started) return;
    this.started = true;
    if (typeof SharedWorker === "undefined") return this.openOwn();
    this.openShared();
  }

  openShared() {
    const worker = new SharedWorker(new URL("./worker.js", import.meta.url), { type: "module", name: `${NAME} ${BASE}` });
    // A browser that cannot run it says so here.
    worker.onerror = () => this.port !== null && ((this.port = null), this.watch.rest(), this.openOwn());
    this.port = worker.port;
    this.port.onmessage = ({ data }) => {
      this.watch.alive(data.intervalS, MISSED);
      if (data.news) this.hear(data.news);
      else if (data.gap !== undefined) this.miss(data.gap);
      else this.handlers.onState(data.open);
    };
    this.join();
  }

  /** Leave a worker that is silent for one that is asked for again: the same if it lives. */
  renew() {
    this.handlers.onState(false);
    this.port?.postMessage({ leave: true });
    this.openShared();
  }

  openOwn() {
    this.own = new Source(this.lastId, { onNews: (news) => this.hear(news), onGap: (id) => this.miss(id), onState: this.handlers.onState }, BASE);
  }

  /** @param {import("./source.js").News} news */
  hear({ topic, id, event }) {
    if (id <= this.lastId) return;
    this.lastId = id;
    this.handlers.onEvent(topic, event);
  }

  /** @param {number} id */
  miss(id) {
    this.lastId = id;
    this.handlers.onGap();
  }
}
