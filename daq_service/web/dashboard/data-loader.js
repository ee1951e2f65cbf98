// Read the data of the page: history first, then what events report as changed. The API is the only source of
// drawn data; an event only names what to read again.

import { getAllPages, get, getLiveness, trend } from "./api.js";
import { readBaselines } from "./charts/baselines.js";

const REFRESH_MS = 200;
const FIT_REFRESH_MS = 1000;
const RETRY_MS = 1000;
const WAITING_MS = 300;
/** Maximum number of sets that are added one by one; with more, all are read again in bins. */
const MAX_SETS = 2000;

/** Columns that the charts always need, by method. @type {Record<string, string[]>} */
export const FIELDS = {
  solitary_wave: [
    "tof_pp_s",
    "amplitude_ratio",
    "distance_squared",
    "limit_f_predictive",
    "limit_mean_3sd",
    "outlier",
    "outlier_mean_3sd",
    "mewma_statistic",
    "thickness_m",
    "interval_low_m",
    "interval_high_m",
  ],
  pulse_echo: ["thickness_m", "interval_low_m", "interval_high_m", "travel_time_s"],
};
const FITTED = /** @type {Record<string, string[]>} */ ({
  solitary_wave: ["tof_pp_s", "amplitude_ratio"],
  pulse_echo: ["thickness_m"],
});

/**
 * @typedef {object} Listener
 * @property {() => string[]} drawn positions that the address shows
 * @property {() => void} onStart the test is known: its positions may be chosen now
 * @property {(news: {alarms?: any[], notes?: any[], transducers?: any, environment?: any, info?: boolean}) => void}
 *   onRead
 * @property {() => void} onColumns columns or fits of a position are new
 * @property {() => void} onDetails only columns of the shown hours are new
 * @property {(reason: string, recorder?: string) => void} onWaiting nothing is stored yet, or the service does not
 *   answer; empty: it does now
 * @property {(error: Error) => void} onTrouble an update failed
 */

export class DataLoader {
  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    /** @type {any} */
    this.info = null;
    /** @type {Map<string, any>} columns by position */
    this.trends = new Map();
    /** Baselines by position, the current one last. @type {Map<string, import("./charts/baselines.js").Baseline[]>} */
    this.baselines = new Map();
    /** @type {Map<string, any>} fits by position and field */
    this.fits = new Map();
    /** @type {Map<string, any[]>} sets without waveforms, by position */
    this.gaps = new Map();
    /** Confirmation sets by position. @type {Map<string, any[]>} */
    this.confirmations = new Map();
    /** @type {any[]} */
    this.alarms = [];
    /** @type {any[]} notes that are not withdrawn */
    this.notes = [];
    this.feature = "";
    /** The shown hours; null: the complete test. @type {[number, number] | null} */
    this.span = null;
    /** Positions that are drawn. @type {string[]} */
    this.drawn = [];
    /** Newest wall thickness from the waves by position. @type {Map<string, any>} */
    this.walls = new Map();
    /** @type {Map<string, any>} columns of these hours, of positions whose complete test comes in bins */
    this.details = new Map();
    /** Timer that reads these columns, or 0. */
    this.detailTimer = 0;
    this.refreshes = 0;
    /** Time of the last complete update, by `performance.now()`. */
    this.readAt = 0;
    this.dirty = {
      positions: new Set(),
      complete: new Set(),
      fits: new Set(),
      gaps: new Set(),
      alarms: false,
      notes: false,
      info: false,
      environment: false,
    };
    this.refreshing = false;
    this.refreshAgain = false;
    this.fitsReadAt = -Infinity;
  }

  /** @param {string} position */
  positionInfo(position) {
    return this.info?.positions.find((/** @type {any} */ positionInfo) => positionInfo.position === position);
  }

  /** Return all columns of the hours of its current baseline. @param {string} position */
  baseline(position) {
    return this.baselines.get(position)?.at(-1)?.trend;
  }

  /** Return whether a position has a reference: for a probe, its first measurement. @param {string} position */
  hasBaseline(position) {
    const probe = this.positionInfo(position)?.method === "pulse_echo";
    const values = probe
      ? this.trends.get(position)?.columns.travel_time_s
      : this.baseline(position)?.columns.in_baseline;
    return Boolean(values?.some((/** @type {number | boolean | null} */ value) => value !== null && value !== false));
  }

  /**
   * Wait until there is something to show, then read it.
   *
   * @param {(after: number) => void} openEvents opens the events after this id
   */
  async start(openEvents) {
    try {
      const { data, recorder, doing } = await getLiveness();
      if (!data) {
        this.listener.onWaiting(
          `${doing ? `Recorder: ${doing}` : "Waiting for the first waveform"}. The first set fills this page.`,
          recorder,
        );
        // From the first event on: the recorder may have asked an operator to strike the first shot.
        openEvents(0);
        setTimeout(() => this.start(openEvents), WAITING_MS);
        return;
      }
      this.info = await get("/info");
    } catch (error) {
      this.listener.onWaiting(`The service does not respond: ${/** @type {Error} */ (error).message}`);
      setTimeout(() => this.start(openEvents), RETRY_MS);
      return;
    }
    this.listener.onWaiting("");
    this.drawn = this.listener.drawn();
    // Later events are read again; earlier ones are in what is read now.
    openEvents(this.info.last_event_id);
    // Request it before the page is built: both then take place at the same time.
    this.reloadAll(0);
    this.listener.onStart();
  }

  reloadAll(delayMs = REFRESH_MS) {
    for (const positionInfo of this.info?.positions ?? []) this.reload(positionInfo.position);
    this.dirty.alarms = this.dirty.notes = this.dirty.info = this.dirty.environment = true;
    this.schedule(delayMs);
  }

  /** @param {string} position */
  reload(position) {
    this.dirty.complete.add(position);
    this.dirty.gaps.add(position);
  }

  readAlarms() {
    this.dirty.alarms = true;
    this.schedule();
  }

  /** Draw another feature. @param {string} feature */
  setFeature(feature) {
    if (feature === this.feature) return;
    this.feature = feature;
    for (const positionInfo of this.info?.positions ?? []) this.dirty.complete.add(positionInfo.position);
    if (this.info) this.schedule();
  }

  /**
   * Show other hours: where the complete test comes in bins, theirs are finer.
   *
   * @param {[number, number] | null} span @param {string[]} positions that are drawn
   */
  setSpan(span, positions) {
    if (String([span, positions]) === String([this.span, this.drawn])) return;
    Object.assign(this, { span, drawn: positions });
    for (const position of positions)
      if (this.trends.get(position)?.method === "solitary_wave" && !this.hasErrors(position)) {
        this.dirty.complete.add(position);
        this.schedule();
      }
    for (const position of this.details.keys())
      if (span === null || !positions.includes(position)) this.details.delete(position);
    if (span !== null && !this.detailTimer && this.coarse().length)
      this.detailTimer = setTimeout(() => this.readDetails(), REFRESH_MS);
  }

  /** Return the drawn positions whose complete test comes in bins. */
  coarse() {
    return this.drawn.filter((position) => (this.trends.get(position)?.bin_sets ?? 1) > 1);
  }

  /** Read columns of the shown hours only: nothing else has changed. */
  async readDetails() {
    this.detailTimer = 0;
    try {
      await Promise.all(this.coarse().map((position) => this.readDetail(position)));
      this.listener.onDetails();
    } catch (error) {
      this.listener.onTrouble(/** @type {Error} */ (error));
      setTimeout(() => this.reloadAll(), 2 * RETRY_MS);
    }
  }

  /** Return the columns to draw of a position: the finest ones of the shown hours. @param {string} position */
  trend(position) {
    return this.details.get(position) ?? this.trends.get(position);
  }

  /** @param {string} topic @param {any} event */
  onEvent(topic, event) {
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
      // A frozen baseline or a correction changes sets that are drawn already.
      if (
        topic === "service" ||
        (topic === "assessments" && (event.set_index ?? last) < last) ||
        String(event.kind).includes("baseline")
      )
        this.reload(event.position);
      if (event.kind === "set_missed" || event.kind === "set_disabled" || event.unscheduled_index)
        dirty.gaps.add(event.position);
      dirty.positions.add(event.position);
    } else if (!["alarms", "service", "environment"].includes(topic)) this.reloadAll();
    else if (topic !== "environment" && event.set_index !== null)
      for (const positionInfo of this.info.positions) dirty.positions.add(positionInfo.position);
    this.schedule();
  }

  schedule(delayMs = REFRESH_MS) {
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
        this.listener.onTrouble(/** @type {Error} */ (error));
        setTimeout(() => this.reloadAll(), 2 * RETRY_MS);
      }
      this.refreshing = false;
      if (this.refreshAgain || this.dirty.positions.size) this.schedule();
    };
    if (delayMs > 0) setTimeout(now, delayMs);
    else void now();
  }

  async refresh() {
    const { dirty } = this;
    const complete = new Set(dirty.complete);
    const changed = new Set([...dirty.positions, ...complete]);
    const { alarms, notes, info, environment } = dirty;
    const gaps = [...dirty.gaps];
    this.dirty = {
      positions: new Set(),
      complete: new Set(),
      fits: dirty.fits,
      gaps: new Set(),
      alarms: false,
      notes: false,
      info: false,
      environment: false,
    };
    const { onRead } = this.listener;
    // The tiles come first: a reader sees them first.
    const readTransducers = async () => {
      const transducers = await get("/transducers");
      for (const { position, last_wall } of transducers.items) if (last_wall) this.walls.set(position, last_wall);
      onRead({ transducers });
    };
    const requests = [readTransducers()];
    const trendsOf = (/** @type {string[]} */ positions) =>
      positions.map((position) => this.readTrend(position, complete.has(position)));
    const initial = [...changed].filter((position) => this.drawn.includes(position) && !this.trends.has(position));
    if (initial.length) {
      for (const position of initial) this.dirty.fits.add(position);
      await Promise.all([...requests.splice(0), ...trendsOf(initial), this.readFits()]);
      this.readAt = performance.now();
      this.listener.onColumns();
    }
    requests.push(...trendsOf([...changed].filter((position) => !initial.includes(position))));
    requests.push(...gaps.map((position) => this.readGaps(position)));
    if (alarms)
      requests.push(getAllPages("/alarms?limit=200").then((items) => onRead({ alarms: (this.alarms = items) })));
    if (notes)
      requests.push(
        getAllPages("/annotations?withdrawn=false&limit=1000").then((items) => onRead({ notes: (this.notes = items) })),
      );
    if (info) requests.push(get("/info").then((answer) => ((this.info = answer), onRead({ info: true }))));
    if (environment) requests.push(this.readEnvironment());
    await Promise.all(requests);
    for (const position of changed) this.dirty.fits.add(position);
    if (performance.now() - this.fitsReadAt > FIT_REFRESH_MS) await this.readFits();
    else
      setTimeout(
        () => this.dirty.fits.size && this.readFits().then(this.listener.onColumns, this.listener.onTrouble),
        FIT_REFRESH_MS,
      );
    this.refreshes += 1;
    this.readAt = performance.now();
    this.listener.onColumns();
  }

  async readEnvironment() {
    this.listener.onRead({ environment: await get("/environment/latest") });
  }

  /** @param {string} position @param {boolean} complete false: only sets after the last known one */
  async readTrend(position, complete) {
    const positionInfo = this.positionInfo(position);
    if (!positionInfo) return;
    const known = complete ? undefined : this.trends.get(position);
    // Sets are not added to bins: another set may change the last bin, and in time the width of all.
    const before = known && known.bin_sets === 1 && known.columns.due_h.length < MAX_SETS ? known : undefined;
    const from_h = before?.columns.due_h.at(-1);
    const baselines = this.baselines.get(position);
    if (complete || !baselines || (from_h ?? 0) <= (baselines.at(-1)?.row.to_h ?? 0))
      this.baselines.set(
        position,
        await readBaselines(position, positionInfo.method, this.info.schedule.baseline_h, complete ? [] : baselines),
      );
    const fields = this.fieldsOf(position);
    const answer = await trend(position, fields, { from_h });
    if (answer.bin_sets > 1 && this.drawn.includes(position)) await this.readDetail(position);
    if (!before || answer.bin_sets > 1) {
      this.trends.set(position, answer.bin_sets > 1 && before ? await trend(position, fields) : answer);
      return;
    }
    // Another update may have arrived first: keep each set once.
    const last = before.columns.set_index.at(-1) ?? -1;
    const start = answer.columns.set_index.findIndex((/** @type {number} */ index) => index > last);
    if (start >= 0)
      for (const key of Object.keys(before.columns)) before.columns[key].push(...answer.columns[key].slice(start));
    before.as_of = answer.as_of;
  }

  /** Return whether its standard errors are known, which only drawn positions need. @param {string} position */
  hasErrors(position) {
    return "standard_error_tof_pp_s" in (this.trends.get(position)?.columns ?? {});
  }

  /** @param {string} position whose baseline has been read */
  fieldsOf(position) {
    const { method } = this.positionInfo(position);
    const also = this.feature in this.baseline(position).units && !FIELDS[method].includes(this.feature);
    const chosen = also ? [this.feature] : [];
    const measured = method === "solitary_wave" ? [...FITTED[method], ...chosen] : [];
    const errors = this.drawn.includes(position) || this.hasErrors(position) ? measured : [];
    return [...FIELDS[method], ...chosen, ...errors.map((name) => `standard_error_${name}`)];
  }

  /** @param {string} position */
  async readDetail(position) {
    const { span } = this;
    if (span === null) return;
    const around = (span[1] - span[0]) / 2;
    const detail = await trend(position, this.fieldsOf(position), { from_h: span[0] - around, to_h: span[1] + around });
    if (String(span) === String(this.span)) this.details.set(position, detail);
  }

  /** Read missed, disabled and unscheduled sets: marks of the charts. @param {string} position */
  async readGaps(position) {
    const which = ["state=missed", "state=disabled", "purpose=confirmation"];
    const pages = await Promise.all(which.map((one) => getAllPages(`/sets?position=${position}&${one}&limit=1000`)));
    this.confirmations.set(position, pages.pop() ?? []);
    this.gaps.set(
      position,
      pages.flat().sort((a, b) => a.set_index - b.set_index),
    );
  }

  async readFits() {
    this.fitsReadAt = performance.now();
    const positions = [...this.dirty.fits];
    this.dirty.fits.clear();
    await Promise.all(
      positions.flatMap((position) =>
        (FITTED[this.positionInfo(position)?.method] ?? []).map(async (field) =>
          this.fits.set(`${position} ${field}`, await get(`/fits/${position}?field=${field}`)),
        ),
      ),
    );
  }
}
