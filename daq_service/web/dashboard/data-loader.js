// What is read and when: history first, then what an event says has changed. The API is the only source of
// what is drawn; an event only says what to read again.

import { all, get, hasData, trend } from "./api.js";
import { livesOf } from "./charts/baselines.js";
import { PLANNED_SETS } from "./format.js";

const REFRESH_MS = 200;
const FIT_REFRESH_MS = 1000;
const RETRY_MS = 1000;
const WAITING_MS = 300;
/** Sets that are gone on with one by one; then the whole is read again, in bins. */
const LONGEST = 2000;

/** Columns that the charts always need, by method. @type {Record<string, string[]>} */
export const FIELDS = {
  solitary_wave: ["tof_pp_s", "amplitude_ratio", "distance_squared", "limit_f", "limit_paper", "outlier", "outlier_paper", "chart"],
  pulse_echo: ["thickness_m", "travel_time_s"],
};
const FITTED = /** @type {Record<string, string[]>} */ ({ solitary_wave: ["tof_pp_s", "amplitude_ratio"], pulse_echo: ["thickness_m"] });

/**
 * @typedef {object} Reader
 * @property {() => string[]} drawn positions that the address shows
 * @property {() => void} onBegin the experiment is known: its positions may be chosen now
 * @property {(news: {alarms?: any[], notes?: any[], transducers?: any, environment?: any, info?: boolean}) => void} onRead
 * @property {() => void} onColumns columns or fits of a position are new
 * @property {() => void} onDetails columns of the hours that are looked at are new, and nothing else
 * @property {(why: string) => void} onWaiting nothing is stored yet, or the service does not answer; empty: over
 * @property {(error: Error) => void} onTrouble a reading failed
 */

export class Reading {
  /** @param {Reader} reader */
  constructor(reader) {
    this.reader = reader;
    /** @type {any} */
    this.info = null;
    /** @type {Map<string, any>} columns by position */
    this.trends = new Map();
    /** Baselines by position, the present one last. @type {Map<string, import("./charts/baselines.js").Life[]>} */
    this.lives = new Map();
    /** @type {Map<string, any>} fits by position and field */
    this.fits = new Map();
    /** @type {Map<string, any[]>} sets without a record, by position */
    this.gaps = new Map();
    /** Confirmation sets by position. @type {Map<string, any[]>} */
    this.beside = new Map();
    /** @type {any[]} */
    this.alarms = [];
    /** @type {any[]} notes that are not withdrawn */
    this.notes = [];
    this.feature = "";
    /** Hours that are looked at; null: the whole test. @type {[number, number] | null} */
    this.span = null;
    /** Positions that are drawn. @type {string[]} */
    this.drawn = [];
    /** @type {Map<string, any>} columns of these hours, of positions whose whole test comes in bins */
    this.details = new Map();
    /** Timer of the reading of these, or 0. */
    this.looking = 0;
    this.refreshes = 0;
    /** When everything that is shown was last read, by `performance.now()`. */
    this.readAt = 0;
    this.dirty = { positions: new Set(), whole: new Set(), fits: new Set(), gaps: new Set(), alarms: false, notes: false, info: false, environment: false };
    this.refreshing = false;
    this.refreshAgain = false;
    this.fitsReadAt = -Infinity;
  }

  /** @param {string} position */
  place(position) {
    return this.info?.positions.find((/** @type {any} */ place) => place.position === position);
  }

  /** All columns of the hours of its present baseline. @param {string} position */
  baseline(position) {
    return this.lives.get(position)?.at(-1)?.trend;
  }

  /** Whether a position has something to differ from: a probe its first reading, whenever that came. @param {string} position */
  hasBaseline(position) {
    const probe = this.place(position)?.method === "pulse_echo";
    const values = probe ? this.trends.get(position)?.columns.travel_time_s : this.baseline(position)?.columns.in_baseline;
    return Boolean(values?.some((/** @type {number | boolean | null} */ value) => value !== null && value !== false));
  }

  /** Read on until there is something to show. @param {(after: number) => void} follow opens the events from there on */
  async begin(follow) {
    try {
      if (!(await hasData())) {
        this.reader.onWaiting("Waiting for the first record. This page fills itself as soon as the recorder has stored something.");
        // From the first event on: somebody may have been asked to strike the first shot.
        follow(0);
        setTimeout(() => this.begin(follow), WAITING_MS);
        return;
      }
      this.info = await get("/info");
    } catch (error) {
      this.reader.onWaiting(`The service does not answer: ${/** @type {Error} */ (error).message}`);
      setTimeout(() => this.begin(follow), RETRY_MS);
      return;
    }
    this.reader.onWaiting("");
    this.drawn = this.reader.drawn();
    // Events from here on are read again; those before are in what is read now.
    follow(this.info.last_event_id);
    // Asked for before the page is built: what the service does meanwhile nobody waits for.
    this.everything(0);
    this.reader.onBegin();
  }

  everything(within_ms = REFRESH_MS) {
    for (const place of this.info?.positions ?? []) this.wholly(place.position);
    this.dirty.alarms = this.dirty.notes = this.dirty.info = this.dirty.environment = true;
    this.schedule(within_ms);
  }

  /** @param {string} position */
  wholly(position) {
    this.dirty.whole.add(position);
    this.dirty.gaps.add(position);
  }

  readAlarms() {
    this.dirty.alarms = true;
    this.schedule();
  }

  /** Another feature is to be drawn. @param {string} feature */
  choose(feature) {
    if (feature === this.feature) return;
    this.feature = feature;
    for (const place of this.info?.positions ?? []) this.dirty.whole.add(place.position);
    if (this.info) this.schedule();
  }

  /**
   * Other hours are looked at: where the whole test comes in bins, theirs are finer.
   *
   * @param {[number, number] | null} span @param {string[]} positions that are drawn
   */
  look(span, positions) {
    if (String([span, positions]) === String([this.span, this.drawn])) return;
    Object.assign(this, { span, drawn: positions });
    for (const position of this.details.keys()) if (span === null || !positions.includes(position)) this.details.delete(position);
    if (span !== null && !this.looking && this.coarse().length) this.looking = setTimeout(() => this.readDetails(), REFRESH_MS);
  }

  /** Positions that are drawn and whose whole test comes in bins. */
  coarse() {
    return this.drawn.filter((position) => (this.trends.get(position)?.bin_sets ?? 1) > 1);
  }

  /** Nothing but the hours that are looked at has changed: nothing else is read. */
  async readDetails() {
    this.looking = 0;
    try {
      await Promise.all(this.coarse().map((position) => this.readDetail(position)));
      this.reader.onDetails();
    } catch (error) {
      this.reader.onTrouble(/** @type {Error} */ (error));
      setTimeout(() => this.everything(), 2 * RETRY_MS);
    }
  }

  /** What is drawn of a position: the finest there is of the hours that are looked at. @param {string} position */
  trend(position) {
    return this.details.get(position) ?? this.trends.get(position);
  }

  /** @param {string} topic @param {any} event */
  hear(topic, event) {
    if (!this.info) return;
    const { dirty } = this;
    if (topic === "annotations") {
      dirty.notes = true;
      this.schedule();
      return;
    }
    if (topic === "alarms") dirty.alarms = true;
    if (topic === "service") dirty.info = true;
    if (topic === "environment") dirty.environment = true;
    if (event.position) {
      const last = this.trends.get(event.position)?.columns.set_index.at(-1) ?? -1;
      // A frozen baseline or a correction changes sets that are already drawn.
      if (topic === "service" || (topic === "verdicts" && (event.set_index ?? last) < last) || String(event.kind).includes("baseline")) this.wholly(event.position);
      if (event.kind === "set_missed" || event.kind === "set_retired" || event.set_index >= PLANNED_SETS) dirty.gaps.add(event.position);
      dirty.positions.add(event.position);
    } else if (!["alarms", "service", "environment"].includes(topic)) this.everything();
    else if (topic !== "environment" && event.set_index !== null) for (const place of this.info.positions) dirty.positions.add(place.position);
    this.schedule();
  }

  schedule(within_ms = REFRESH_MS) {
    if (this.refreshing) {
      this.refreshAgain = true;
      return;
    }
    this.refreshing = true;
    const now = async () => {
      this.refreshAgain = false;
      try {
        await this.refresh();
      } catch (error) {
        this.reader.onTrouble(/** @type {Error} */ (error));
        setTimeout(() => this.everything(), 2 * RETRY_MS);
      }
      this.refreshing = false;
      if (this.refreshAgain || this.dirty.positions.size) this.schedule();
    };
    if (within_ms > 0) setTimeout(now, within_ms);
    else void now();
  }

  async refresh() {
    const { dirty } = this;
    const whole = new Set(dirty.whole);
    const changed = new Set([...dirty.positions, ...whole]);
    const { alarms, notes, info, environment } = dirty;
    const gaps = [...dirty.gaps];
    this.dirty = { positions: new Set(), whole: new Set(), fits: dirty.fits, gaps: new Set(), alarms: false, notes: false, info: false, environment: false };
    const { onRead } = this.reader;
    // First of all: what the tiles say is the first thing to be seen.
    const standing = async () => {
      const transducers = await get("/transducers");
      onRead({ transducers });
    };
    const readings = [standing()];
    const trendsOf = (/** @type {string[]} */ positions) => positions.map((position) => this.readTrend(position, whole.has(position)));
    const firstly = [...changed].filter((position) => this.drawn.includes(position) && !this.trends.has(position));
    if (firstly.length) {
      for (const position of firstly) this.dirty.fits.add(position);
      await Promise.all([...readings.splice(0), ...trendsOf(firstly), this.readFits()]);
      this.readAt = performance.now();
      this.reader.onColumns();
    }
    readings.push(...trendsOf([...changed].filter((position) => !firstly.includes(position))));
    readings.push(...gaps.map((position) => this.readGaps(position)));
    if (alarms) readings.push(all("/alarms?limit=200").then((items) => onRead({ alarms: (this.alarms = items) })));
    if (notes) readings.push(all("/annotations?withdrawn=false&limit=1000").then((items) => onRead({ notes: (this.notes = items) })));
    if (info) readings.push(get("/info").then((answer) => ((this.info = answer), onRead({ info: true }))));
    if (environment) readings.push(this.readEnvironment());
    await Promise.all(readings);
    for (const position of changed) this.dirty.fits.add(position);
    if (performance.now() - this.fitsReadAt > FIT_REFRESH_MS) await this.readFits();
    else setTimeout(() => this.dirty.fits.size && this.readFits().then(this.reader.onColumns, this.reader.onTrouble), FIT_REFRESH_MS);
    this.refreshes += 1;
    this.readAt = performance.now();
    this.reader.onColumns();
  }

  async readEnvironment() {
    this.reader.onRead({ environment: await get("/environment/latest") });
  }

  /** @param {string} position @param {boolean} whole false: only what is newer than what is here */
  async readTrend(position, whole) {
    const place = this.place(position);
    if (!place) return;
    const known = whole ? undefined : this.trends.get(position);
    // Bins are not gone on with: another set may change the last one, and in time their width.
    const before = known && known.bin_sets === 1 && known.columns.due_h.length < LONGEST ? known : undefined;
    const from_h = before?.columns.due_h.at(-1);
    const lives = this.lives.get(position);
    if (whole || !lives || (from_h ?? 0) <= (lives.at(-1)?.row.to_h ?? 0)) this.lives.set(position, await livesOf(position, place.method, this.info.schedule.baseline_h, whole ? [] : lives));
    const fields = this.fieldsOf(position);
    const answer = await trend(position, fields, { from_h });
    if (answer.bin_sets > 1 && this.drawn.includes(position)) await this.readDetail(position);
    if (!before || answer.bin_sets > 1) {
      this.trends.set(position, answer.bin_sets > 1 && before ? await trend(position, fields) : answer);
      return;
    }
    // Another reading may have come first: keep each set once.
    const last = before.columns.set_index.at(-1) ?? -1;
    const start = answer.columns.set_index.findIndex((/** @type {number} */ index) => index > last);
    if (start >= 0) for (const key of Object.keys(before.columns)) before.columns[key].push(...answer.columns[key].slice(start));
    before.as_of = answer.as_of;
  }

  /** @param {string} position whose baseline's hours were read */
  fieldsOf(position) {
    const always = FIELDS[this.place(position).method];
    const also = this.feature in this.baseline(position).columns && !always.includes(this.feature);
    return also ? [...always, this.feature] : always;
  }

  /** @param {string} position */
  async readDetail(position) {
    const { span } = this;
    if (span === null) return;
    const around = (span[1] - span[0]) / 2;
    const detail = await trend(position, this.fieldsOf(position), { from_h: span[0] - around, to_h: span[1] + around });
    if (String(span) === String(this.span)) this.details.set(position, detail);
  }

  /** Sets that were missed, fell into a retirement or stand beside the plan: marks of the charts. @param {string} position */
  async readGaps(position) {
    const which = ["state=missed", "state=retired", "purpose=confirmation"];
    const pages = await Promise.all(which.map((one) => all(`/sets?position=${position}&${one}&limit=1000`)));
    this.beside.set(position, pages.pop() ?? []);
    this.gaps.set(position, pages.flat().sort((a, b) => a.set_index - b.set_index));
  }

  async readFits() {
    this.fitsReadAt = performance.now();
    const positions = [...this.dirty.fits];
    this.dirty.fits.clear();
    await Promise.all(
      positions.flatMap((position) => (FITTED[this.place(position)?.method] ?? []).map(async (field) => this.fits.set(`${position} ${field}`, await get(`/fits/${position}?field=${field}`)))),
    );
  }
}
