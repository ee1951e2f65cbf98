// Notices a connection that is frozen: while it works it brings heartbeats, and after a sleep it may be dead.

const LOOK_MS = 1000;
/** The second missed heartbeat may come a little late. */
const MISSED = 2.2;
/** A service that is there answers sooner; a browser may try a connection that it kept and that is dead. */
const CONNECT_S = 10;

export class Watch {
  /** @param {number} intervalS between heartbeats, until one states another @param {() => void} onSilent called after each silence */
  constructor(intervalS, onSilent) {
    this.intervalS = intervalS;
    this.onSilent = onSilent;
    this.withinS = 0;
    /** By the wall clock, since others stop while the computer sleeps; 0: nothing is expected. */
    this.since = 0;
    setInterval(() => this.look(), LOOK_MS);
  }

  /** A sign of life: another one is expected. @param {number} [intervalS] @param {number} [missed] */
  alive(intervalS, missed = MISSED) {
    this.intervalS = intervalS || this.intervalS;
    this.withinS = missed * this.intervalS;
    this.since = Date.now();
  }

  connecting() {
    this.alive();
    this.withinS = Math.min(this.withinS, CONNECT_S);
  }

  rest() {
    this.since = 0;
  }

  look() {
    if (this.since === 0) return;
    // A clock that was set back starts the time again.
    this.since = Math.min(this.since, Date.now());
    if (Date.now() - this.since <= this.withinS * 1000) return;
    this.since = Date.now();
    this.onSilent();
  }
}
