// Wires the page: what is shown stands in its address, what is drawn comes from the API.

import { SolimonAlarms } from "./alarms.js";
import { BASE, trend } from "./api.js";
import { Asked } from "./prompt.js";
import { BaselineCard } from "./baseline-card.js";
import { Board } from "./charts/board.js";
import { SolimonChart } from "./charts/chart.js";
import { Compared } from "./charts/comparison.js";
import { Others, isOther, whereOf } from "./charts/other-tests.js";
import { wholeOf } from "./charts/plot.js";
import { Toolbar } from "./charts/toolbar.js";
import { Audit } from "./control/audit.js";
import { confirmed } from "./control/confirm.js";
import { Control } from "./control/panel.js";
import { enter, may } from "./control/session.js";
import { byId, setText } from "./dom.js";
import { EventStream } from "./events/stream.js";
import { showEnvironment } from "./environment.js";
import { Failing } from "./update-failure.js";
import { tiles } from "./startup.js";
import { hour, significant, utc } from "./format.js";
import { Hold } from "./pause.js";
import { RECORDER, chip } from "./icons.js";
import { admitted } from "./login.js";
import { SolimonNotes } from "./notes.js";
import { Notifications } from "./notifications.js";
import { giveBy } from "./commands.js";
import { Reading } from "./data-loader.js";
import { Retired } from "./disabled.js";
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
/** Hours before and after an alarm or a note that a click on its hour shows. */
const AROUND_H = 5;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

const waveform = /** @type {SolimonWaveform} */ (byId("waveform"));
const waterfall = /** @type {SolimonWaterfall} */ (byId("waterfall"));
const alarmList = /** @type {SolimonAlarms} */ (byId("alarms"));
const notes = /** @type {SolimonNotes} */ (byId("notes"));
const panel = /** @type {SolimonSet} */ (byId("set"));
const state = { connected: false, hasSupply: false, recorder: "absent", shown: "", now_h: 0, toldAt: 0 };

const address = new Address(become);
/** @type {Reading} */
const reading = new Reading({ drawn: () => board.drawn(address.view, charted()).all, onBegin, onRead, onColumns, onDetails: showColumns, onWaiting: notice, onTrouble: (error) => failing.fail(error, reading.readAt) });
const failing = new Failing(byId("failing"));
const others = new Others(onOthers);
/** @type {Board} */
const board = new Board(
  reading,
  others,
  {
    span: () => address.span,
    show: (span, gesture) => address.go({ from_h: span?.[0] ?? null, to_h: span?.[1] ?? null }, { gesture }),
    timeline,
    open: openSet,
    note: (at, ask) => (ask ? notes.ask(at, address.view.position) : void (notes.pointed = at)),
    table: (id, shown) => address.go({ tables: shown ? [...address.view.tables, id] : address.view.tables.filter((one) => one !== id) }),
  },
  (feature) => address.go({ feature }),
);
const compared = new Compared(others, (part) => address.go(part));
const toolbar = new Toolbar((part) => address.go(part), nowH);
tiles.onSelect = select;
const asked = new Asked();
const hold = new Hold((text) => notice(text, "alarm"));
const control = new Control((text) => notice(text, "alarm"));
const baselineCard = new BaselineCard(byId("baseline"), (text) => notice(text, "alarm"));
const retired = new Retired(byId("retired"), (text) => notice(text, "alarm"));
const waves = new WaveformStream((record) => waveform.show(record));
const events = new EventStream({ onEvent, onGap: () => reading.everything(), onState });
/** @type {import("./set/panel.js").Host} */
const panelHost = {
  info: () => reading.info,
  units: (position) => reading.baseline(position)?.units ?? reading.trends.get(position)?.units ?? {},
  ghost: ghostOf,
  last: (position) => Math.max(reading.trends.get(position)?.columns.set_index.at(-1) ?? 0, reading.gaps.get(position)?.at(-1)?.set_index ?? 0),
  view: () => address.view,
  go: (part, how) => address.go(part, how),
};
panel.host = panelHost;
/** @type {import("./waterfall/panel.js").Host} */
const waterfallHost = {
  info: () => (reading.trends.has(address.view.position) ? reading.info : null),
  view: () => address.view,
  go: (part, how) => address.go(part, how),
  whole: () => wholeOf(/** @type {any} */ ({ x: reading.trends.get(address.view.position)?.columns.due_h ?? [], endHour: reading.info.schedule.end_h })),
  timeline,
  open: openSet,
  over: (position) => {
    const { ranges, alarms, opened } = board.about(address.view, [position]);
    return { gaps: ranges.filter((range) => range.tone !== "good"), alarms, opened };
  },
  trend,
  hasBaseline: () => reading.hasBaseline(address.view.position),
};
waterfall.host = waterfallHost;
/** @type {import("./alarm-evidence.js").Host} */
const proofHost = {
  trend: (position) => reading.trends.get(position),
  timeline,
  open: openSet,
  note: (at, ask) => (ask ? notes.ask(at, address.view.position) : void (notes.pointed = at)),
};
alarmList.host = proofHost;
/** @type {import("./notes.js").Host} */
const notesHost = {
  span: () => address.span,
  positions: () => reading.info?.positions.map((/** @type {any} */ place) => place.position) ?? [],
  show: ([from_h, to_h]) => showHours(from_h, to_h),
  now: nowH,
};
notes.host = notesHost;

// ---- what is shown ----------------------------------------------------------------------------

function timeline() {
  return new Timeline(address.view.axis, reading.info?.clock.epoch_utc ?? "1970-01-01T00:00:00Z");
}

/** Hour of the test by its own clock; a simulated one stands still between two readings. */
function nowH() {
  return state.now_h + (reading.info?.clock.kind === "wall" ? (performance.now() - state.toldAt) / HOUR_MS : 0);
}

/** Hours, and what lies around them. @param {number} from @param {number} to @param {Partial<import("./view.js").View>} [part] what else changes */
function showHours(from, to, part = {}) {
  address.go({ from_h: from - AROUND_H, to_h: to + AROUND_H, ...part });
}

/** Position of the solitary-wave charts: the chosen one where it has waves. */
function charted() {
  const { position, charts } = address.view;
  const waves_ = reading.info.positions.filter((/** @type {any} */ place) => place.method === "solitary_wave").map((/** @type {any} */ place) => place.position);
  return [position, charts].find((one) => waves_.includes(one)) ?? waves_[0] ?? "";
}

/** What changes with the chosen position. @param {string} position @returns {Partial<import("./view.js").View>} */
function chosen(position) {
  if (position === address.view.position) return {};
  const waves_ = reading.place(position)?.method === "solitary_wave";
  return { position, charts: waves_ ? "" : charted(), set: null, shot: null, from_us: null, to_us: null };
}

/** @param {string} position */
function select(position) {
  if (reading.place(position)) address.go(chosen(position));
}

/** @param {string} position @param {number} set */
function openSet(position, set) {
  if (isOther(position)) {
    const where = whereOf(position);
    location.assign(`/tests/${where.test}/?position=${where.position}&set=${set}`);
    return;
  }
  address.go({ ...chosen(position), set, shot: null });
}

/** The baseline's set that lies nearest to its middle. @param {string} position */
function ghostOf(position) {
  const { columns, method } = reading.baseline(position) ?? { columns: { set_index: [] }, method: "" };
  // A probe refers to its first good record.
  if (method === "pulse_echo") return columns.set_index[columns.quality.indexOf("good")] ?? null;
  let best = -1;
  columns.set_index.forEach((/** @type {number} */ _, /** @type {number} */ k) => {
    if (columns.in_baseline[k] && columns.distance_squared[k] !== null && (best < 0 || columns.distance_squared[k] < columns.distance_squared[best])) best = k;
  });
  return best < 0 ? null : columns.set_index[best];
}

/** @param {import("./view.js").View} view @param {import("./view.js").View} before */
function become(view, before) {
  if (view.theme !== before.theme) theme.show();
  if (!reading.info) return;
  // A position that this experiment does not have, e.g. of an address from elsewhere.
  if (!reading.place(view.position)) view.position = charted() || reading.info.positions[0].position;
  if (view.position !== state.shown) {
    state.shown = view.position;
    tiles.select(view.position);
    waveform.select(view.position, reading.place(view.position).label);
    waves.open(view.position);
  }
  reading.choose(view.feature);
  others.choose(view);
  reading.look(address.span, board.drawn(view, charted()).all);
  const { from_h, to_h, from_us, to_us, ...rest } = view;
  const { from_h: _a, to_h: _b, from_us: _c, to_us: _d, ...restBefore } = before;
  toolbar.update(view, charted(), reading.info, timeline());
  compared.update(view);
  if (JSON.stringify(rest) !== JSON.stringify(restBefore)) board.update(view, charted());
  for (const chart of board.all) chart.respan();
  waterfall.update();
  panel.update();
  showBaseline();
}

function showBaseline() {
  const rows = (reading.lives.get(charted()) ?? []).map((life) => life.row);
  baselineCard.update(charted(), rows, state.recorder !== "finished" && state.recorder !== "stopped");
}

function showAll() {
  become(address.view, { ...address.view, position: "", axis: "hours" });
  showColumns();
}

// ---- reading ----------------------------------------------------------------------------------

function onBegin() {
  asked.show(reading.info.asked);
  showInfo();
  showAll();
}

function onColumns() {
  failing.end();
  showColumns();
  showBaseline();
  toolbar.update(address.view, charted(), reading.info, timeline());
  compared.update(address.view);
  waterfall.renew(String([reading.trends.get(address.view.position)?.columns.set_index.at(-1), reading.gaps.get(address.view.position)?.length]));
  panel.update();
  alarmList.renew();
}

function onOthers() {
  showColumns();
  compared.update(address.view);
}

function showColumns() {
  board.update(address.view, charted());
}

/** @param {{alarms?: any[], notes?: any[], transducers?: any, environment?: any, info?: boolean}} news */
function onRead({ alarms, notes: noted, transducers, environment, info }) {
  if (alarms) alarmList.update(alarms);
  if (noted) notes.update(noted);
  if (info) {
    asked.show(reading.info.asked);
    showInfo();
  }
  if (transducers) {
    tiles.update(transducers);
    retired.update(transducers);
    control.update(reading.info, transducers.items, transducers.as_of.recorder);
    showClock(transducers.as_of);
    showBaseline();
  }
  if (environment) {
    state.hasSupply = environment.supply_now !== null;
    showEnvironment(byId("environment"), environment);
  }
}

/** @param {string} topic @param {any} event */
function onEvent(topic, event) {
  if (topic === "service") asked.hear(event);
  reading.hear(topic, event);
  const { position, set } = address.view;
  const concerns = event.position === position && (event.set_index === set || String(event.kind).includes("baseline"));
  if (set !== null && concerns) void panel.read();
}

// ---- showing ----------------------------------------------------------------------------------

function showInfo() {
  const { info } = reading;
  document.title = `${info.name} · solimon`;
  setText(byId("experiment"), info.name);
  const rig = byId("rig");
  rig.hidden = false;
  setText(rig, info.rig_label);
  rig.dataset.rig = info.rig;
  setText(byId("approval"), `${info.clock.kind} clock${info.clock.pace_h_per_s ? `, ${significant(info.clock.pace_h_per_s)} h a second` : ""}`);
  setText(byId("hour-total"), ` of ${hour(info.schedule.end_h)} h`);
  setText(byId("version"), `solimon ${info.version}`);
  byId("finish").hidden = !info.clock.can_finish_now || !may("finish_now");
  tiles.lossLimit = info.limits.thickness_loss_fraction;
  showClock(info.as_of);
}

/** @param {any} asOf */
function showClock(asOf) {
  setText(byId("hour"), `Hour ${hour(asOf.now_h)}`);
  setText(byId("utc"), `${utc(asOf.now_utc)} on the ${asOf.clock} clock`);
  /** @type {HTMLProgressElement} */ (byId("progress")).value = reading.info ? Math.min(1, asOf.now_h / reading.info.schedule.end_h) : 0;
  Object.assign(state, { recorder: asOf.recorder, now_h: asOf.now_h, toldAt: performance.now() });
  if (state.recorder !== "running") byId("finish").hidden = true;
  hold.update(reading.info?.held ?? null, state.recorder);
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
  const look = !state.connected
    ? { word: "Connection lost, retrying", icon: "link", tone: "alarm" }
    : (RECORDER[state.recorder] ?? { word: state.recorder, icon: "dash", tone: "" });
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

// ---- controls ---------------------------------------------------------------------------------

function redraw() {
  board.redraw();
  waveform.draw();
  if (reading.info) waterfall.update();
  panel.draw();
  alarmList.redraw();
}

const theme = new Theme(() => address.view.theme, (next) => address.go({ theme: /** @type {any} */ (next) }, { step: true }), redraw);
byId("finish").addEventListener("click", async () => {
  const button = /** @type {HTMLButtonElement} */ (byId("finish"));
  const says = ["The rest of the simulated test runs as fast as it goes. It cannot be slowed down again."];
  if ((await confirmed({ title: "Finish the test now", says, word: "Run to the end" })) === null) return;
  if (await giveBy(button, "finish_now", {}, (text) => notice(text, "alarm"))) {
    button.disabled = true;
    setText(button, "Finishing");
  }
});
alarmList.addEventListener("trouble", (event) => notice(/** @type {CustomEvent} */ (event).detail, "alarm"));
notes.addEventListener("trouble", (event) => notice(/** @type {CustomEvent} */ (event).detail, "alarm"));
alarmList.addEventListener("show-hour", (event) => {
  const { position, hour: at } = /** @type {CustomEvent} */ (event).detail;
  showHours(at, at, position === null ? {} : chosen(position));
  waterfall.scrollIntoView({ block: "nearest" });
});
// A shelf ends in real time, too: where nobody records, no event says so.
setInterval(() => alarmList.items.some((alarm) => alarm.suppressed === "shelved") && reading.readAlarms(), SHELF_MS);
// Where no recorder runs no event comes, and the supply's own process may switch off.
setInterval(() => state.hasSupply && reading.readEnvironment().catch((error) => failing.fail(error, reading.readAt)), SUPPLY_MS);
theme.show();
byId("all-tests").hidden = BASE === "";

/** Read-only view of what is shown, for tests and for the curious. */
Object.defineProperty(window, "solimonDashboard", {
  value: Object.freeze({
    get ready() {
      return reading.refreshes > 0;
    },
    get connected() {
      return state.connected;
    },
    get refreshes() {
      return reading.refreshes;
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

enter(await admitted());
new Audit();
reading.feature = address.view.feature;
reading.span = address.span;
reading.begin((after) => events.open(after));
const notifications = new Notifications(byId("notifications"), (error) => failing.fail(error, reading.readAt));
notifications.begin().catch((error) => failing.fail(error, reading.readAt));
