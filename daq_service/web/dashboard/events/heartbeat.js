// Detect a frozen connection: while it works it brings heartbeats, and after a sleep it may be dead.

const CHECK_MS = 1000;
/** The second missed heartbeat may come slightly late. */
const MISSED_BEATS = 2.2;
/** A running service answers sooner; a browser may try a cached connection that is dead. */
const CONNECT_S = 10;

export class HeartbeatMonitor {
  /**
   * @param {number} intervalS between heartbeats, until one states another interval
   * @param {() => void} onTimeout called after each silence
   */
  constructor(intervalS, onTimeout) {
    this.intervalS = intervalS;
    this.onTimeout = onTimeout;
    this.timeoutS = 0;
    /** By the wall clock, since other clocks stop while the computer sleeps; 0: no heartbeat is expected. */
    this.lastBeatMs = 0;
    setInterval(() => this.check(), CHECK_MS);
  }

  /** Record a heartbeat and expect the next one. @param {number} [intervalS] @param {number} [missed] */
  beat(intervalS, missed = MISSED_BEATS) {
    this.intervalS = intervalS || this.intervalS;
    this.timeoutS = missed * this.intervalS;
    this.lastBeatMs = Date.now();
  }

  connecting() {
    this.beat();
    this.timeoutS = Math.min(this.timeoutS, CONNECT_S);
  }

  stop() {
    this.lastBeatMs = 0;
  }

  check() {
    if (this.lastBeatMs === 0) return;
    // If the clock was set back, the time starts again.
    this.lastBeatMs = Math.min(this.lastBeatMs, Date.now());
    if (Date.now() - this.lastBeatMs <= this.timeoutS * 1000) return;
    this.lastBeatMs = Date.now();
    this.onTimeout();
  }
}
