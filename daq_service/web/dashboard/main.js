// Wires the page: history first, then events and waveforms as they come. The API is the only source
// of what is drawn; an event only says what to read again.

import { all, get, hasData } from "./api.js";
import { SolimonAlarms } from "./alarms.js";
import { Asked } from "./asked.js";
import { SolimonChart } from "./chart.js";
import { byId, setText } from "./dom.js";
import { fixed, hour, scientific, significant, utc } from "./format.js";
import { showEnvironment } from "./environment.js";
import { Hold } from "./hold.js";
import { chip } from "./icons.js";
import { order } from "./orders.js";
import { Retired } from "./retired.js";
import { EventStream, WaveformStream } from "./streams.js";
import { Tiles } from "./tiles.js";
import { SolimonWaveform } from "./waveform.js";

customElements.define("solimon-chart", SolimonChart);
customElements.define("solimon-waveform", SolimonWaveform);
customElements.define("solimon-alarms", SolimonAlarms);

const REFRESH_MS = 200;
const FIT_REFRESH_MS = 1000;
const RETRY_MS = 1000;
const SUPPLY_MS = 5000;
const WAITING_MS = 300;
const NOTICE_MS = 60_000;
const FAILED = "The last reading failed";
/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

/** Columns a chart needs, by method. @type {Record<string, string[]>} */
const FIELDS = {
  solitary_wave: ["tof_pp_s", "amplitude_ratio", "distance_squared", "limit_f", "limit_paper", "outlier", "outlier_paper"],
  pulse_echo: ["thickness_m", "travel_time_s"],
};
const FITTED = { solitary_wave: ["tof_pp_s", "amplitude_ratio"], pulse_echo: ["thickness_m"] };

const charts = {
  distance: /** @type {SolimonChart} */ (byId("distance")),
  tof: /** @type {SolimonChart} */ (byId("tof")),
  amplitudeRatio: /** @type {SolimonChart} */ (byId("amplitude-ratio")),
  thickness: /** @type {SolimonChart} */ (byId("thickness")),
};
const waveform = /** @type {SolimonWaveform} */ (byId("waveform"));
const alarmList = /** @type {SolimonAlarms} */ (byId("alarms"));

const state = {
  /** @type {any} */ info: null,
  /** @type {string} */ selected: "",
  /** @type {string} the solitary-wave position that the charts show */ charted: "",
  /** @type {Map<string, any>} columns by position */ trends: new Map(),
  /** @type {Map<string, any>} fits by position and field */ fits: new Map(),
  connected: false,
  ready: false,
  hasSupply: false,
  refreshes: 0,
};
/** What is to be read again. */
const dirty = { positions: new Set(), whole: new Set(), fits: new Set(), alarms: false, info: false, environment: false };
let refreshing = false;
let refreshAgain = false;
let fitsReadAt = -Infinity;

configureCharts();
const tiles = new Tiles(byId("tiles"), select);
const asked = new Asked();
const hold = new Hold((text) => notice(text, "alarm"));
const retired = new Retired(byId("retired"), (text) => notice(text, "alarm"));
const waves = new WaveformStream((record) => waveform.show(record));
const events = new EventStream({ onEvent, onGap: everything, onState });

function configureCharts() {
  const fit = { label: "2nd-order fit", short: "fit", key: "fit", color: "--fit", kind: /** @type {"line"} */ ("line"), dash: [7, 4] };
  charts.distance.configure({
    title: "Mahalanobis squared distance",
    name: "Squared distance D²",
    unit: "",
    digits: 2,
    log: true,
    empty: "No distance yet: it needs the baseline",
    curves: [
      { label: "D² of a set", short: "D²", key: "distance_squared", color: "--data", kind: "points" },
      { label: "predictive F limit", short: "F limit", key: "limit_f", color: "--limit", kind: "line" },
      { label: "paper's mean + 3 SD limit", short: "paper's limit", key: "limit_paper", color: "--limit-other", kind: "line", dash: [2, 4] },
    ],
  });
  charts.tof.configure({
    title: "Time of flight",
    name: "Time of flight (µs)",
    unit: "µs",
    digits: 3,
    empty: "No set yet",
    curves: [{ label: "time of flight, peak to peak", short: "time of flight", key: "tof_pp_us", color: "--data", kind: "points" }, fit],
  });
  charts.amplitudeRatio.configure({
    title: "Amplitude ratio",
    name: "Amplitude ratio PSW / ISW",
    unit: "",
    digits: 4,
    empty: "No set yet",
    curves: [{ label: "amplitude ratio", short: "amplitude ratio", key: "amplitude_ratio", color: "--data", kind: "points" }, fit],
  });
  charts.thickness.configure({
    title: "Wall thickness",
    name: "Wall thickness (mm)",
    unit: "mm",
    digits: 3,
    empty: "No pulse-echo record yet",
    curves: [{ label: "thickness, pulse echo", short: "thickness", key: "thickness_mm", color: "--data", kind: "points" }, fit],
  });
}

/** @param {string} position */
function placeOf(position) {
  return state.info?.positions.find((/** @type {any} */ place) => place.position === position);
}

/** @param {string} position */
function select(position) {
  if (!placeOf(position) || position === state.selected) return;
  state.selected = position;
  if (placeOf(position).method === "solitary_wave") state.charted = position;
  tiles.select(position);
  waveform.select(position, placeOf(position).label);
  waves.open(position);
  drawAll();
}

// ---- reading ----------------------------------------------------------------------------------

async function begin() {
  try {
    if (!(await hasData())) {
      notice("Waiting for the first record. This page fills itself as soon as the recorder has stored something.");
      // From the first event on: somebody may have been asked to strike the first shot.
      if (!events.source) events.open(0);
      setTimeout(begin, WAITING_MS);
      return;
    }
    state.info = await get("/info");
  } catch (error) {
    notice(`The service does not answer: ${/** @type {Error} */ (error).message}`, "alarm");
    setTimeout(begin, RETRY_MS);
    return;
  }
  notice("");
  asked.show(state.info.asked);
  showInfo();
  const places = state.info.positions;
  const first = places.find((/** @type {any} */ place) => place.method === "solitary_wave") ?? places[0];
  state.charted = first.method === "solitary_wave" ? first.position : "";
  // Events from here on are read again; those before are in what is read now.
  events.open(state.info.last_event_id);
  select(first.position);
  everything();
}

function everything() {
  for (const place of state.info?.positions ?? []) dirty.whole.add(place.position);
  dirty.alarms = true;
  dirty.info = true;
  dirty.environment = true;
  schedule();
}

/** @param {string} topic @param {any} event */
function onEvent(topic, event) {
  if (topic === "service") asked.hear(event);
  if (!state.info) return;
  if (topic === "alarms") dirty.alarms = true;
  if (topic === "service") dirty.info = true;
  if (topic === "environment") dirty.environment = true;
  if (event.position) {
    const rows = state.trends.get(event.position)?.columns.set_index ?? [];
    const last = rows.length ? rows[rows.length - 1] : -1;
    // A frozen baseline or a correction changes sets that are already drawn.
    if (topic === "service" || (topic === "verdicts" && (event.set_index ?? last) < last) || String(event.kind).includes("baseline")) dirty.whole.add(event.position);
    dirty.positions.add(event.position);
  } else if (!["alarms", "service", "environment"].includes(topic)) everything();
  else if (topic !== "environment" && event.set_index !== null) for (const place of state.info.positions) dirty.positions.add(place.position);
  schedule();
}

function schedule() {
  if (refreshing) {
    refreshAgain = true;
    return;
  }
  refreshing = true;
  setTimeout(async () => {
    refreshAgain = false;
    try {
      await refresh();
    } catch (error) {
      notice(`${FAILED}: ${/** @type {Error} */ (error).message}`, "alarm");
      everythingLater();
    }
    refreshing = false;
    if (refreshAgain) schedule();
  }, REFRESH_MS);
}

function everythingLater() {
  setTimeout(everything, 2 * RETRY_MS);
}

async function refresh() {
  const whole = new Set(dirty.whole);
  const changed = new Set([...dirty.positions, ...whole]);
  const withAlarms = dirty.alarms;
  const withInfo = dirty.info;
  const withEnvironment = dirty.environment;
  dirty.whole.clear();
  dirty.positions.clear();
  dirty.alarms = false;
  dirty.info = false;
  dirty.environment = false;
  const readings = [...changed].map((position) => readTrend(position, whole.has(position)));
  if (withAlarms) readings.push(all("/alarms?limit=200").then((items) => alarmList.update(items)));
  if (withInfo) readings.push(get("/info").then((info) => void ((state.info = info), asked.show(info.asked), showInfo())));
  readings.push(get("/transducers").then((answer) => (tiles.update(answer), retired.update(answer), showClock(answer.as_of))));
  if (withEnvironment) readings.push(readEnvironment());
  await Promise.all(readings);
  for (const position of changed) dirty.fits.add(position);
  if (performance.now() - fitsReadAt > FIT_REFRESH_MS) await readFits();
  else setTimeout(() => dirty.fits.size && readFits().then(drawAll, () => undefined), FIT_REFRESH_MS);
  state.ready = true;
  state.refreshes += 1;
  // What an order was refused for stays: new values are no answer to it.
  if (byId("notice").textContent?.startsWith(FAILED)) notice("");
  drawAll();
}

async function readEnvironment() {
  const answer = await get("/environment/latest");
  state.hasSupply = answer.supply_now !== null;
  showEnvironment(byId("environment"), answer);
}

/** @param {string} position @param {boolean} whole false: only what is newer than what is here */
async function readTrend(position, whole) {
  const place = placeOf(position);
  if (!place) return;
  const before = whole ? undefined : state.trends.get(position);
  const hours = before?.columns.due_h ?? [];
  const from = hours.length ? `&from_h=${hours[hours.length - 1]}` : "";
  const answer = await get(`/trends/${position}?fields=${FIELDS[place.method].join(",")}${from}`);
  if (before) {
    // Another reading may have come first: keep each set once.
    const last = before.columns.set_index.at(-1) ?? -1;
    const start = answer.columns.set_index.findIndex((/** @type {number} */ index) => index > last);
    if (start >= 0) for (const key of Object.keys(before.columns)) before.columns[key].push(...answer.columns[key].slice(start));
    before.as_of = answer.as_of;
  } else state.trends.set(position, answer);
}

async function readFits() {
  fitsReadAt = performance.now();
  const positions = [...dirty.fits];
  dirty.fits.clear();
  await Promise.all(
    positions.flatMap((position) => {
      const method = /** @type {"solitary_wave" | "pulse_echo"} */ (placeOf(position)?.method);
      return (FITTED[method] ?? []).map(async (field) => state.fits.set(`${position} ${field}`, await get(`/fits/${position}?field=${field}`)));
    }),
  );
}

// ---- showing ----------------------------------------------------------------------------------

function showInfo() {
  const { info } = state;
  document.title = `${info.name} · solimon`;
  setText(byId("experiment"), info.name);
  const rig = byId("rig");
  rig.hidden = false;
  setText(rig, info.rig_label);
  rig.dataset.rig = info.rig;
  setText(byId("approval"), `${info.clock.kind} clock${info.clock.pace_h_per_s ? `, ${significant(info.clock.pace_h_per_s)} h a second` : ""}`);
  setText(byId("hour-total"), ` of ${hour(info.schedule.end_h)} h`);
  setText(byId("version"), `solimon ${info.version}`);
  byId("finish").hidden = !info.clock.can_finish_now;
  tiles.lossLimit = info.limits.thickness_loss_fraction;
  showClock(info.as_of);
}

/** @param {any} asOf */
function showClock(asOf) {
  setText(byId("hour"), `Hour ${hour(asOf.now_h)}`);
  setText(byId("utc"), `${utc(asOf.now_utc)} on the ${asOf.clock} clock`);
  /** @type {HTMLProgressElement} */ (byId("progress")).value = state.info ? Math.min(1, asOf.now_h / state.info.schedule.end_h) : 0;
  recorder = asOf.recorder;
  if (recorder !== "running") byId("finish").hidden = true;
  hold.update(state.info?.held ?? null, recorder);
  showConnection();
}

let recorder = "absent";

/** @param {boolean} open */
function onState(open) {
  state.connected = open;
  tiles.online = open;
  tiles.tick();
  showConnection();
}

function showConnection() {
  const pill = byId("connection");
  const look = !state.connected
    ? { word: "Connection lost, retrying", icon: "link", tone: "alarm" }
    : {
        running: { word: "Live", icon: "check", tone: "good" },
        finished: { word: "Test finished", icon: "flag", tone: "info" },
        stopped: { word: "Recorder stopped", icon: "stop", tone: "warn" },
        silent: { word: "Recorder silent", icon: "triangle", tone: "alarm" },
        absent: { word: "Recorder absent", icon: "triangle", tone: "warn" },
      }[recorder] ?? { word: recorder, icon: "dash", tone: "" };
  if (pill.textContent === look.word) return;
  const fresh = chip(look, "pill");
  pill.dataset.tone = look.tone;
  pill.replaceChildren(...fresh.childNodes);
}

/** @param {string} text @param {string} [tone] */
function notice(text, tone = "") {
  const element = byId("notice");
  clearTimeout(noticeTimer);
  if (tone) noticeTimer = setTimeout(() => notice(""), NOTICE_MS);
  element.hidden = text === "";
  element.dataset.tone = tone;
  setText(element, text);
}

/** @param {any} fit @param {number[]} x @param {number} scale */
function fitCurve(fit, x, scale) {
  if (!fit?.coefficients) return x.map(() => null);
  const [c0, c1, c2] = fit.coefficients;
  return x.map((t) => (t >= fit.from_h && t <= fit.to_h ? scale * (c0 + (c1 + c2 * t) * t) : null));
}

/** @param {any} fit @param {number} scale @param {string} unit */
function equation(fit, scale, unit) {
  if (!fit?.coefficients) return fit?.reason ?? "no fit yet";
  const [c0, c1, c2] = fit.coefficients.map((/** @type {number} */ c) => scale * c);
  const sign = (/** @type {number} */ value) => (value < 0 ? "− " : "+ ") + scientific(Math.abs(value));
  return `${significant(c0)} ${sign(c1)} t ${sign(c2)} t²${unit ? ` ${unit}` : ""}, t in h · R² ${fixed(fit.r_squared, 3)} · residual SD ${significant(scale * fit.residual_sd)}${unit ? ` ${unit}` : ""}`;
}

/** @param {(number | null)[]} values @param {number} scale */
function scaled(values, scale) {
  return values.map((value) => (value === null ? null : value * scale));
}

function drawAll() {
  if (!state.info) return;
  const endHour = state.info.schedule.end_h;
  const bandUntil = state.info.schedule.baseline_h;
  const trend = state.trends.get(state.charted);
  if (trend) {
    const { due_h: x, quality } = trend.columns;
    const deciding = state.info.limits.deciding;
    const at = `Position ${state.charted}`;
    charts.distance.update({
      x,
      y: [trend.columns.distance_squared, trend.columns.limit_f, trend.columns.limit_paper],
      marked: trend.columns.outlier,
      quality,
      bandUntil,
      endHour,
      subtitle: `${at} · ${deciding === "f_predictive" ? `the F limit decides (${significant(100 * state.info.limits.false_alarm_rate)} % false alarms)` : "the paper's limit decides"} · alarm at ${state.info.limits.k} of ${state.info.limits.n}`,
    });
    const tofFit = state.fits.get(`${state.charted} tof_pp_s`);
    charts.tof.update({
      x,
      y: [scaled(trend.columns.tof_pp_s, 1e6), fitCurve(tofFit, x, 1e6)],
      quality,
      bandUntil,
      endHour,
      subtitle: `${at} · ${equation(tofFit, 1e6, "µs")}`,
    });
    const ratioFit = state.fits.get(`${state.charted} amplitude_ratio`);
    charts.amplitudeRatio.update({
      x,
      y: [trend.columns.amplitude_ratio, fitCurve(ratioFit, x, 1)],
      quality,
      bandUntil,
      endHour,
      subtitle: `${at} · ${equation(ratioFit, 1, "")}`,
    });
  }
  const probes = state.info.positions.filter((/** @type {any} */ place) => place.method === "pulse_echo");
  const probe = probes.find((/** @type {any} */ place) => place.position === state.selected) ?? probes[0];
  charts.thickness.hidden = !probe;
  const wall = probe && state.trends.get(probe.position);
  if (wall) {
    const { due_h: x, quality } = wall.columns;
    const fit = state.fits.get(`${probe.position} thickness_m`);
    charts.thickness.update({
      x,
      y: [scaled(wall.columns.thickness_m, 1e3), fitCurve(fit, x, 1e3)],
      quality,
      bandUntil,
      endHour,
      subtitle: `Position ${probe.position} · ${equation(fit, 1e3, "mm")}`,
    });
  }
}

// ---- controls ---------------------------------------------------------------------------------

const THEMES = ["auto", "light", "dark"];

/** @param {string} theme */
function setTheme(theme) {
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  setText(byId("theme"), `Theme: ${theme}`);
  localStorage.setItem("solimon-theme", theme);
  redraw();
}

function redraw() {
  for (const chart of Object.values(charts)) chart.draw();
  waveform.draw();
}

byId("theme").addEventListener("click", () => {
  const at = THEMES.indexOf(localStorage.getItem("solimon-theme") ?? "auto");
  setTheme(THEMES[(at + 1) % THEMES.length]);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
byId("finish").addEventListener("click", async () => {
  const button = /** @type {HTMLButtonElement} */ (byId("finish"));
  button.disabled = true;
  try {
    await order("finish_now", {}, (word) => setText(button, word));
    setText(button, "Finishing");
  } catch (error) {
    button.disabled = false;
    setText(button, "Finish now");
    notice(/** @type {Error} */ (error).message, "alarm");
  }
});
alarmList.addEventListener("trouble", (event) => notice(/** @type {CustomEvent} */ (event).detail, "alarm"));
setInterval(() => tiles.tick(), 1000);
// Where no recorder runs no event comes, and the supply's own process may switch off.
setInterval(() => state.hasSupply && readEnvironment().catch(() => undefined), SUPPLY_MS);
setTheme(THEMES.includes(localStorage.getItem("solimon-theme") ?? "") ? /** @type {string} */ (localStorage.getItem("solimon-theme")) : "auto");

/** Read-only view of what is shown, for tests and for the curious. */
Object.defineProperty(window, "solimonDashboard", {
  value: Object.freeze({
    get ready() {
      return state.ready;
    },
    get connected() {
      return state.connected;
    },
    get refreshes() {
      return state.refreshes;
    },
    get selected() {
      return state.selected;
    },
    get lastEventId() {
      return events.lastId;
    },
    get charts() {
      return Object.fromEntries(Object.entries(charts).map(([name, chart]) => [name, chart.snapshot()]));
    },
    get waveform() {
      return waveform.snapshot();
    },
    get alarms() {
      return structuredClone(alarmList.items);
    },
    select,
  }),
  writable: false,
});

begin();
