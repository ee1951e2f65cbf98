// The list of a service's tests: what each is, how it stands, how old that is, the way to its page.

import { get } from "./api.js";
import { byId, el, setText } from "./dom.js";
import { Failing } from "./update-failure.js";
import { ageText, hour } from "./format.js";
import { RECORDER, SEVERITIES, STATES, chip } from "./icons.js";
import { admitted } from "./login.js";
import { Theme } from "./theme.js";

const REFRESH_MS = 5000;
const TICK_MS = 1000;

/** Why a test cannot be shown, as a word. @type {Record<string, string>} */
const ABSENT = {
  no_data: "No data yet",
  missing: "Folder not there",
  foreign: "No test",
  misconfigured: "Configuration refused",
  damaged: "Damaged",
  other_version: "Another version",
  locked: "Locked by its own tokens",
  unreadable: "Not readable",
};

const root = byId("tests");
const failing = new Failing(byId("failing"));
/** @type {any[]} */
let items = [];
let readAt = 0;

/** Seconds that what is shown has aged since the service looked. @param {any} item */
const agedS = (item) => item.looked_age_s + (performance.now() - readAt) / 1000;

/** @param {any} item @returns {HTMLElement} */
function card(item) {
  const { standing } = item;
  const title = standing ? el("a", { class: "test-name", href: item.page, text: item.name }) : el("span", { class: "test-name", text: item.name });
  const head = el("div", { class: "test-head" }, el("h2", {}, title));
  const card_ = el("li", { class: "card test" }, head);
  card_.dataset.test = item.test;
  card_.dataset.state = standing?.state ?? item.state;
  if (!standing) {
    head.append(chip({ word: ABSENT[item.state] ?? item.state, icon: "dash", tone: item.state === "no_data" ? "info" : "warn" }));
    card_.append(el("p", { text: item.detail }), el("p", { class: "test-remedy", text: item.remedy }), el("p", { class: "quiet small", text: item.source }));
    return card_;
  }
  head.append(chip(STATES[standing.state]), chip(RECORDER[standing.recorder]));
  if (standing.highest_severity) head.append(chip({ ...SEVERITIES[standing.highest_severity], word: `${standing.active_alarms} alarm${standing.active_alarms > 1 ? "s" : ""}, worst ${standing.highest_severity}` }));
  if (standing.held) head.append(chip({ word: "On hold", icon: "pause", tone: "warn" }));
  const positions = standing.positions.map((/** @type {any} */ place) => el("li", {}, el("span", { class: "quiet", text: place.position }), " ", chip(STATES[place.state])));
  card_.append(
    el("p", {}, el("span", { class: "badge", text: standing.rig_label }), ` hour ${hour(standing.now_h)} of ${hour(standing.end_h)} h on the ${standing.clock} clock`),
    el("ul", { class: "test-positions", "aria-label": `${standing.positions.length} positions` }, ...positions),
    el("p", { class: "tile-age" }),
    el("p", { class: "quiet small", text: item.source }),
  );
  card_.dataset.stale = String(standing.stale);
  return card_;
}

function show() {
  const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest("[data-test]"))?.dataset.test;
  root.replaceChildren(...items.map(card));
  if (focused) /** @type {HTMLElement | null} */ (root.querySelector(`[data-test="${focused}"] a`))?.focus();
  const shown = items.filter((item) => item.standing).length;
  setText(byId("summary"), `${items.length} tests${shown < items.length ? `, ${items.length - shown} of them cannot be shown` : ""}`);
  tick();
}

function tick() {
  for (const item of items) {
    const age = root.querySelector(`[data-test="${item.test}"] .tile-age`);
    if (age) setText(age, `${item.standing.last_set_index === null ? "" : `Set ${item.standing.last_set_index} · `}${ageText(item.standing, { ...item.standing, data_h: item.standing.last_set_h }, agedS(item))}`);
  }
}

async function read() {
  if (document.hidden) return;
  try {
    ({ items } = await get("/tests"));
    readAt = performance.now();
    failing.end();
    show();
  } catch (error) {
    failing.fail(/** @type {Error} */ (error), readAt);
  }
}

/** Again and again, each time once the answer has come. */
async function readOn() {
  await read();
  setTimeout(readOn, REFRESH_MS);
}

/** @type {Theme} */
const theme = new Theme(() => "", () => theme.show(), () => {});
theme.show();
setInterval(tick, TICK_MS);
document.addEventListener("visibilitychange", read);
await admitted();
await readOn();
