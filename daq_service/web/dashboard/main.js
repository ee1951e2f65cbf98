// Connect the parts of the page: its address holds the view, the API provides the data.

import { SolimonAlarms } from "./alarms.js";
import { BASE, trend } from "./api.js";
import { OperatorPrompt } from "./prompt.js";
import { BaselineCard } from "./baseline-card.js";
import { Board } from "./charts/board.js";
import { SolimonChart } from "./charts/chart.js";
import { Comparison } from "./charts/comparison.js";
import { OtherTests, isOther, parseEntry } from "./charts/other-tests.js";
import { fullSpan } from "./charts/plot.js";
import { Toolbar } from "./charts/toolbar.js";
import { Audit } from "./control/audit.js";
import { askConfirmation } from "./control/confirm.js";
import { RunControl } from "./control/panel.js";
import { startSession, isAllowed } from "./control/session.js";
import { byId, setText } from "./dom.js";
import { EventStream } from "./events/stream.js";
import { showEnvironment } from "./environment.js";
import { UpdateFailure } from "./update-failure.js";
import { tiles } from "./startup.js";
import { hour, setKey, setLocalTime, significant, time } from "./format.js";
import { rankActive, showHeadline } from "./headline.js";
import { PauseControl } from "./pause.js";
import { RECORDER, chip } from "./icons.js";
import { waitForLogin } from "./login.js";
import { SolimonNotes } from "./notes.js";
import { Notifications } from "./notifications.js";
import { sendByButton } from "./commands.js";
import { DataLoader } from "./data-loader.js";
import { DisabledTransducers } from "./disabled.js";
import { SolimonSet } from "./set/panel.js";
import { WaveformStream } from "./streams.js";
import { Theme } from "./theme.js";
import { Timeline } from "./timeline.js";
import { Address } from "./view.js";
import { SolimonWaterfall } from "./waterfall/panel.js";
import { SolimonWaveform } from "./waveform.js";

customElements.define("solimon-chart", SolimonChart);
customElements.define("solimon-waterfall", SolimonWaterfall);
customElements.define("solimon-waveform", SolimonWaveform);
customElements.define("solimon-alarms", SolimonAlarms);
customElements.define("solimon-set", SolimonSet);
customElements.define("solimon-notes", SolimonNotes);

const SUPPLY_MS = 5000;
const NOTICE_MS = 60_000;
const SHELF_MS = 30_000;
const HOUR_MS = 3_600_000;
/** Hours shown before and after an alarm or annotation when its hour is clicked. */
const AROUND_H = 5;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

const waveform = /** @type {SolimonWaveform} */ (byId("waveform"));
const waterfall = /** @type {SolimonWaterfall} */ (byId("waterfall"));
const alarmList = /** @type {SolimonAlarms} */ (byId("alarms"));
const notes = /** @type {SolimonNotes} */ (byId("notes"));
const panel = /** @type {SolimonSet} */ (byId("set"));
const state = { connected: false, hasSupply: false, recorder: "not_started", shown: "", now_h: 0, clockReadAt: 0 };
/** Last answers of the API. @type {{alarms?: any[], transducers?: any}} */
const latest = {};

const address = new Address(show);
/** @type {DataLoader} */
const data = new DataLoader({
  drawn: () => board.drawn(address.view, chartedPosition()).all,
  onStart,
  onRead,
  onColumns,
  onDetails: showColumns,
  onWaiting: (reason, recorder = state.recorder) => {
    notice(reason);
    state.recorder = recorder;
    showConnection();
  },
  onTrouble: (error) => updateFailure.fail(error, data.readAt),
});
const updateFailure = new UpdateFailure(byId("update-failure"));
const otherTests = new OtherTests(onOthers);
/** @type {Board} */
const board = new Board(
  data,
  otherTests,
  {
    span: () => address.span,
    full: fullHours,
    show: (span, gesture) => address.go({ from_h: span?.[0] ?? null, to_h: span?.[1] ?? null }, { gesture }),
    timeline,
    open: openSet,
    note: (at, ask) => (ask ? notes.ask(at, address.view.position) : void (notes.pointed = at)),
    table: (id, shown) =>
      address.go({ tables: shown ? [...address.view.tables, id] : address.view.tables.filter((one) => one !== id) }),
  },
  (feature) => address.go({ feature }),
);
const comparison = new Comparison(otherTests, (changes) => address.go(changes));
const toolbar = new Toolbar((changes) => address.go(changes), nowH);
tiles.onSelect = select;
const operatorPrompt = new OperatorPrompt();
const pauseControl = new PauseControl((text) => notice(text, "alarm"));
const runControl = new RunControl((text) => notice(text, "alarm"));
const baselineCard = new BaselineCard(byId("baseline"), (text) => notice(text, "alarm"));
const disabled = new DisabledTransducers(byId("disabled"), (text) => notice(text, "alarm"));
const waves = new WaveformStream((newWaveform) => waveform.show(newWaveform));
const events = new EventStream({ onEvent, onGap: () => data.reloadAll(), onState });
/** @type {import("./set/panel.js").Host} */
const panelHost = {
  info: () => data.info,
  units: (position) => data.baseline(position)?.units ?? data.trends.get(position)?.units ?? {},
  ghost: typicalSet,
  last: (position) =>
    Math.max(data.trends.get(position)?.columns.set_index.at(-1) ?? 0, data.gaps.get(position)?.at(-1)?.set_index ?? 0),
  view: () => address.view,
  go: (changes, how) => address.go(changes, how),
};
panel.host = panelHost;
/** @type {import("./waterfall/panel.js").Host} */
const waterfallHost = {
  info: () => (data.trends.has(address.view.position) ? data.info : null),
  view: () => address.view,
  go: (changes, how) => address.go(changes, how),
  full: fullHours,
  timeline,
  open: openSet,
  over: (position) => {
    const { ranges, alarms, opened } = board.context(address.view, [position]);
    return { gaps: ranges.filter((range) => range.tone !== "good"), alarms, opened };
  },
  trend,
  hasBaseline: () => data.hasBaseline(address.view.position),
};
waterfall.host = waterfallHost;
/** @type {import("./alarm-evidence.js").Host} */
const evidenceHost = {
  trend: (position) => data.trends.get(position),
  timeline,
  open: openSet,
  note: (at, ask) => (ask ? notes.ask(at, address.view.position) : void (notes.pointed = at)),
};
alarmList.host = evidenceHost;
/** @type {import("./notes.js").Host} */
const notesHost = {
  span: () => address.span,
  positions: () => data.info?.positions.map((/** @type {any} */ positionInfo) => positionInfo.position) ?? [],
  show: ([from_h, to_h]) => showHours(from_h, to_h),
  now: nowH,
};
notes.host = notesHost;

// ---- what is shown ----------------------------------------------------------------------------

function timeline() {
  return new Timeline(address.view.axis, data.info?.clock.epoch_utc ?? "1970-01-01T00:00:00Z");
}

/** Return the hours that charts show without a zoom: to the newest set of all positions. */
function fullHours() {
  const newest = [...data.trends.values(), ...otherTests.trends.values()].map((one) => one.columns.due_h.at(-1) ?? 0);
  return fullSpan(Math.max(0, ...newest), data.info?.schedule.end_h ?? 1);
}

/** Return the hour of the test by its own clock; a simulated clock does not advance between two updates. */
function nowH() {
  return state.now_h + (data.info?.clock.kind === "wall" ? (performance.now() - state.clockReadAt) / HOUR_MS : 0);
}

/**
 * Show hours with their surroundings.
 *
 * @param {number} from
 * @param {number} to
 * @param {Partial<import("./view.js").View>} [changes] what else changes
 */
function showHours(from, to, changes = {}) {
  address.go({ from_h: from - AROUND_H, to_h: to + AROUND_H, ...changes });
}

/** Return the position of the solitary-wave charts: the chosen one where it has waves. */
function chartedPosition() {
  const { position, charts } = address.view;
  const solitaryWave = data.info.positions
    .filter((/** @type {any} */ positionInfo) => positionInfo.method === "solitary_wave")
    .map((/** @type {any} */ positionInfo) => positionInfo.position);
  return [position, charts].find((one) => solitaryWave.includes(one)) ?? solitaryWave[0] ?? "";
}

/**
 * Return what changes with the chosen position.
 *
 * @param {string} position
 * @returns {Partial<import("./view.js").View>}
 */
function selection(position) {
  if (position === address.view.position) return {};
  const solitaryWave = data.positionInfo(position)?.method === "solitary_wave";
  return { position, charts: solitaryWave ? "" : chartedPosition(), set: null, shot: null, from_us: null, to_us: null };
}

/** @param {string} position */
function select(position) {
  if (data.positionInfo(position)) address.go(selection(position));
}

/** @param {string} position @param {import("./format.js").SetKey} set */
function openSet(position, set) {
  if (isOther(position)) {
    const where = parseEntry(position);
    location.assign(`/tests/${where.test}/?position=${where.position}&set=${set}`);
    return;
  }
  address.go({ ...selection(position), set, shot: null });
}

/** Return the set of the baseline that is closest to its center. @param {string} position */
function typicalSet(position) {
  const { columns, method } = data.baseline(position) ?? { columns: { set_index: [] }, method: "" };
  // A probe refers to its first good waveform.
  if (method === "pulse_echo") return columns.set_index[columns.quality.indexOf("good")] ?? null;
  let best = -1;
  columns.set_index.forEach((/** @type {number} */ _, /** @type {number} */ k) => {
    if (
      columns.in_baseline[k] &&
      columns.distance_squared[k] !== null &&
      (best < 0 || columns.distance_squared[k] < columns.distance_squared[best])
    )
      best = k;
  });
  return best < 0 ? null : columns.set_index[best];
}

/** @param {import("./view.js").View} view @param {import("./view.js").View} before */
function show(view, before) {
  if (view.theme !== before.theme) theme.show();
  setLocalTime(view.axis === "local");
  byId("charts").dataset.axis = view.axis;
  if (!data.info) return;
  if (view.axis !== before.axis) showTimes();
  // The address may name a position that this test does not have.
  if (!data.positionInfo(view.position)) view.position = chartedPosition() || data.info.positions[0].position;
  if (view.position !== state.shown) {
    state.shown = view.position;
    tiles.select(view.position);
    waveform.select(view.position, data.positionInfo(view.position).label);
    waves.open(view.position);
  }
  data.setFeature(view.feature);
  otherTests.choose(view);
  data.setSpan(address.span, board.drawn(view, chartedPosition()).all);
  const { from_h, to_h, from_us, to_us, ...rest } = view;
  const { from_h: _a, to_h: _b, from_us: _c, to_us: _d, ...restBefore } = before;
  toolbar.update(view, chartedPosition(), data.info, timeline());
  comparison.update(view);
  if (JSON.stringify(rest) !== JSON.stringify(restBefore)) board.update(view, chartedPosition());
  for (const chart of board.all) chart.applySpan();
  waterfall.update();
  panel.update();
  showBaseline();
}

/** Show times in the chosen zone, e.g. after it has changed. */
function showTimes() {
  alarmList.render();
  notes.update(data.notes);
  if (latest.transducers) showClock(latest.transducers.as_of);
  tiles.render();
}

function showBaseline() {
  const rows = (data.baselines.get(chartedPosition()) ?? []).map((period) => period.row);
  baselineCard.update(chartedPosition(), rows, state.recorder !== "finished" && state.recorder !== "stopped");
}

function showAll() {
  show(address.view, { ...address.view, position: "", axis: "hours" });
  showColumns();
}

// ---- reading ----------------------------------------------------------------------------------

function onStart() {
  operatorPrompt.show(data.info.asked);
  alarmList.handover.start(data.info.last_event_id);
  showInfo();
  showAll();
}

function onColumns() {
  updateFailure.clear();
  showColumns();
  showBaseline();
  toolbar.update(address.view, chartedPosition(), data.info, timeline());
  comparison.update(address.view);
  waterfall.renew(
    String([
      data.trends.get(address.view.position)?.columns.set_index.at(-1),
      data.gaps.get(address.view.position)?.length,
    ]),
  );
  panel.update();
  alarmList.renew();
}

function onOthers() {
  showColumns();
  comparison.update(address.view);
}

function showColumns() {
  tiles.showTrends(data, fullHours()[1]);
  board.update(address.view, chartedPosition());
}

/** @param {{alarms?: any[], notes?: any[], transducers?: any, environment?: any, info?: boolean}} news */
function onRead({ alarms, notes: noteRows, transducers, environment, info }) {
  if (alarms) {
    latest.alarms = alarms;
    alarmList.update(alarms);
    tiles.showAlarms(rankActive(alarms));
  }
  if (noteRows) notes.update(noteRows);
  if (info) {
    operatorPrompt.show(data.info.asked);
    showInfo();
  }
  if (transducers) {
    latest.transducers = transducers;
    tiles.update(transducers);
    disabled.update(transducers);
    runControl.update(data.info, transducers.items, transducers.as_of.recorder);
    showClock(transducers.as_of);
    showBaseline();
  }
  showNewest();
  if (environment) {
    state.hasSupply = environment.supply_now !== null;
    showEnvironment(byId("environment"), environment);
  }
}

/** Show the most urgent alarm, or the age of the newest data, which grows without news. */
function showNewest() {
  if (latest.alarms && latest.transducers)
    showHeadline(byId("headline"), latest.alarms, latest.transducers.items, state.recorder, nowH());
}

/** @param {string} topic @param {any} event */
function onEvent(topic, event) {
  if (topic === "service") operatorPrompt.onEvent(event);
  data.onEvent(topic, event);
  alarmList.handover.add(topic, event);
  const { position, set } = address.view;
  const concerns = event.position === position && (setKey(event) === set || String(event.kind).includes("baseline"));
  if (set !== null && concerns) void panel.read();
}

// ---- showing ----------------------------------------------------------------------------------

function showInfo() {
  const { info } = data;
  document.title = `${info.name} · solimon`;
  setText(byId("experiment"), info.name);
  const rig = byId("rig");
  rig.hidden = false;
  setText(rig, info.rig_label);
  rig.dataset.rig = info.rig;
  setText(
    byId("approval"),
    `${info.clock.kind} clock${info.clock.pace_h_per_s ? `, ${significant(info.clock.pace_h_per_s)} h per s` : ""}`,
  );
  setText(byId("hour-total"), ` of ${hour(info.schedule.end_h)} h`);
  setText(byId("version"), `solimon ${info.version}`);
  byId("finish").hidden = !info.clock.can_finish_now || !isAllowed("finish_now");
  tiles.setLimits(info);
  showClock(info.as_of);
}

/** @param {any} asOf */
function showClock(asOf) {
  setText(byId("hour"), `Hour ${hour(asOf.now_h)}`);
  const pace = asOf.pace_h_per_s ? `; slower than set: ${significant(asOf.pace_h_per_s)} h per s` : "";
  setText(byId("time"), `${time(asOf.now_utc)}, ${asOf.clock} clock${pace}`);
  /** @type {HTMLProgressElement} */ (byId("progress")).value = data.info
    ? Math.min(1, asOf.now_h / data.info.schedule.end_h)
    : 0;
  Object.assign(state, { recorder: asOf.recorder, now_h: asOf.now_h, clockReadAt: performance.now() });
  if (state.recorder !== "running") byId("finish").hidden = true;
  const ended = state.recorder === "finished";
  waveform.setLive(!ended);
  if (alarmList.testEnded !== ended) {
    alarmList.testEnded = ended;
    alarmList.render();
  }
  pauseControl.update(data.info?.paused ?? null, state.recorder);
  showConnection();
}

/** @param {boolean} open */
function onState(open) {
  state.connected = open;
  tiles.online = open;
  tiles.tick();
  showConnection();
}

function showConnection() {
  const pill = byId("connection");
  const connectionState = !state.connected
    ? { label: "Connection lost, retrying", icon: "link", tone: "alarm" }
    : (RECORDER[state.recorder] ?? { label: state.recorder, icon: "dash", tone: "" });
  if (pill.textContent === connectionState.label) return;
  const newPill = chip(connectionState, "pill");
  pill.dataset.tone = connectionState.tone;
  pill.replaceChildren(...newPill.childNodes);
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

// ---- controls ---------------------------------------------------------------------------------

function redraw() {
  board.redraw();
  waveform.draw();
  if (data.info) waterfall.update();
  panel.draw();
  alarmList.redraw();
}

const theme = new Theme(
  () => address.view.theme,
  (next) => address.go({ theme: /** @type {any} */ (next) }, { step: true }),
  redraw,
);
byId("finish").addEventListener("click", async () => {
  const button = /** @type {HTMLButtonElement} */ (byId("finish"));
  const paragraphs = ["The rest of the simulated test runs at full speed. You cannot slow it down again."];
  if ((await askConfirmation({ title: "Skip to end", paragraphs, submitLabel: "Skip to end" })) === null) return;
  if (await sendByButton(button, "finish_now", {}, (text) => notice(text, "alarm"))) {
    button.disabled = true;
    setText(button, "Finishing");
  }
});
alarmList.addEventListener("trouble", (event) => notice(/** @type {CustomEvent} */ (event).detail, "alarm"));
notes.addEventListener("trouble", (event) => notice(/** @type {CustomEvent} */ (event).detail, "alarm"));
alarmList.addEventListener("show-hour", (event) => {
  const { position, hour: at } = /** @type {CustomEvent} */ (event).detail;
  showHours(at, at, position === null ? {} : selection(position));
  waterfall.scrollIntoView({ block: "nearest" });
});
// Shelving also ends in real time: where no recorder runs, no event reports it.
setInterval(showNewest, SHELF_MS);
setInterval(() => alarmList.items.some((alarm) => alarm.suppressed === "shelved") && data.readAlarms(), SHELF_MS);
// Without a recorder there are no events, and the supply's own process may switch off.
setInterval(
  () => state.hasSupply && data.readEnvironment().catch((error) => updateFailure.fail(error, data.readAt)),
  SUPPLY_MS,
);
theme.show();
byId("all-tests").hidden = BASE === "";

/** Read-only state of the page, for tests and the console. */
Object.defineProperty(window, "solimonDashboard", {
  value: Object.freeze({
    get ready() {
      return data.refreshes > 0;
    },
    get connected() {
      return state.connected;
    },
    get refreshes() {
      return data.refreshes;
    },
    get view() {
      return structuredClone(address.view);
    },
    get lastEventId() {
      return events.lastId;
    },
    get charts() {
      return Object.fromEntries(Object.entries(board.charts).map(([name, chart]) => [name, chart.snapshot()]));
    },
    get set() {
      return panel.snapshot();
    },
    get waterfall() {
      return waterfall.snapshot();
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

const session = await waitForLogin();
// Another page could lead a click on an embedded one.
startSession(address.view.embed ? { ...session, may: [] } : session);
new Audit();
data.feature = address.view.feature;
data.span = address.span;
data.start((after) => events.open(after));
const notifications = new Notifications(byId("notifications"), (error) => updateFailure.fail(error, data.readAt));
notifications.start().catch((error) => updateFailure.fail(error, data.readAt));
