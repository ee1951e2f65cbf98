// List what happened since this browser's last visit, for a shift handover.

import { BASE } from "./api.js";
import { el } from "./dom.js";
import { utc } from "./format.js";

const KEY = `solimon-visit${BASE}`;
/** A longer absence starts another visit. */
const AWAY_MS = 15 * 60_000;
const SAVE_MS = 60_000;
const SHOW_MS = 100;

/** Group and text of each kind of change of an alarm. @type {Record<string, [string, string]>} */
const CHANGES = {
  alarm_raised: ["raised", "raised"],
  alarm_priority_raised: ["raised", "priority raised"],
  alarm_reactivated: ["raised", "active again"],
  alarm_shelf_expired: ["raised", "shelving ended"],
  alarm_cleared: ["returned to normal", "returned to normal"],
  alarm_reset: ["returned to normal", "reset"],
  alarm_acknowledged: ["acknowledged", "acknowledged"],
  alarm_shelved: ["shelved", "shelved"],
  alarm_out_of_service: ["shelved", "taken out of service"],
  alarm_unshelved: ["shelved", "unshelved"],
  alarm_in_service: ["shelved", "returned to service"],
};

const GROUPS = [...new Set(Object.values(CHANGES).map(([group]) => group)), "commanded"];

/** Return the text of a change of an alarm. @param {string} kind of its event */
export const changeText = (kind) => CHANGES[kind]?.[1] ?? kind.replace("alarm_", "").replaceAll("_", " ");

/** @typedef {{id: number, ms: number}} Visit last event that was shown, and real time */

export class Handover {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this.onChange = onChange;
    /** Events in order. @type {Map<number, any>} */
    this.events = new Map();
    /** Whether the service no longer has the oldest events. */
    this.incomplete = false;
    /** @type {Visit} */
    this.since = { id: Infinity, ms: 0 };
    this.lastId = 0;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
  }

  /** Read what happened between the last visit and an event that the page has. @param {number} lastId */
  start(lastId) {
    const { since, seen } = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    this.lastId = lastId;
    const now = { id: lastId, ms: Date.now() };
    // A first visit, or another test in the same folder.
    if (!seen || seen.id > lastId) this.since = now;
    else this.since = now.ms - seen.ms > AWAY_MS ? seen : since;
    this.save();
    setInterval(() => document.hidden || this.save(), SAVE_MS);
    addEventListener("pagehide", () => this.save());
    if (this.since.id >= lastId) return;
    const source = new EventSource(`${BASE}/api/v1/stream?topics=alarms,service,annotations&after=${this.since.id}`);
    for (const topic of ["alarms", "service", "annotations"])
      source.addEventListener(topic, (message) => this.add(topic, JSON.parse(message.data)));
    source.addEventListener("gap", () => (this.incomplete = true));
    // The next heartbeat follows the stored events; live ones come over the page's own connection.
    source.addEventListener("heartbeat", () => source.close());
    source.addEventListener("error", () => ((this.incomplete = true), source.close()));
  }

  save() {
    localStorage.setItem(KEY, JSON.stringify({ since: this.since, seen: { id: this.lastId, ms: Date.now() } }));
  }

  /** Start another visit. */
  markRead() {
    this.since = { id: this.lastId, ms: Date.now() };
    this.save();
    this.onChange();
  }

  /** @param {string} topic @param {any} event */
  add(topic, event) {
    this.lastId = Math.max(this.lastId, event.id);
    if (!this.groupOf(topic, event) || this.events.has(event.id)) return;
    this.events.set(event.id, { ...event, topic });
    clearTimeout(this.timer);
    this.timer = setTimeout(this.onChange, SHOW_MS);
  }

  /** Return the group of an event; empty: it is not listed. @param {string} topic @param {any} event */
  groupOf(topic, event) {
    if (topic === "alarms") return CHANGES[event.kind]?.[0] ?? "";
    return event.payload?.author ? "commanded" : "";
  }

  /** Return the events of this visit, the newest first. */
  list() {
    return [...this.events.values()].filter(({ id }) => id > this.since.id).sort((a, b) => b.id - a.id);
  }

  /** Return the ids of the alarms that changed. @returns {Set<number>} */
  alarms() {
    return new Set(this.list().flatMap(({ topic, payload }) => (topic === "alarms" ? [payload.alarm_id] : [])));
  }

  /** Return the count of each group, e.g. "2 raised, 1 commanded"; empty: nothing. */
  summary() {
    const groups = this.list().map((event) => this.groupOf(event.topic, event));
    const counts = GROUPS.map((group) => [groups.filter((one) => one === group).length, group]);
    return counts.flatMap(([count, group]) => (count ? [`${count} ${group}`] : [])).join(", ");
  }

  /** Return the list as an element. @param {(id: number) => string} headline of an alarm */
  element(headline) {
    const lines = this.list().map(({ utc: time, topic, kind, position, payload }) => {
      const what = topic === "alarms" ? `${headline(payload.alarm_id)}: ${changeText(kind)}` : changeText(kind);
      const author = payload.author ? ` by ${payload.author}` : "";
      const where = topic === "alarms" || !position ? "" : ` ${position}`;
      return el("li", { text: `${utc(time)} · ${what}${where}${author}` });
    });
    const started = utc(new Date(this.since.ms).toISOString());
    const older = this.incomplete ? " Older events are not available here; see the audit log." : "";
    return el("div", {}, el("p", { class: "quiet", text: `Last visit: ${started}.${older}` }), el("ul", {}, ...lines));
  }
}
