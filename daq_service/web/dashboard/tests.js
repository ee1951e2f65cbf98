// List the tests of a service: name, state, age of the data and a link to the page of each.

import { get } from "./api.js";
import { byId, el, setText } from "./dom.js";
import { UpdateFailure } from "./update-failure.js";
import { ageText, hour } from "./format.js";
import { RECORDER, PRIORITIES, STATES, chip } from "./icons.js";
import { waitForLogin } from "./login.js";
import { Theme } from "./theme.js";

const REFRESH_MS = 5000;
const TICK_MS = 1000;

/** Labels for tests that cannot be shown, by reason. @type {Record<string, string>} */
const ABSENT = {
  no_data: "No data yet",
  missing: "Folder not found",
  foreign: "Not a data folder",
  misconfigured: "Invalid configuration",
  damaged: "Corrupt",
  other_version: "Other version",
  locked: "Token required",
  unreadable: "Unreadable",
};

const root = byId("tests");
const updateFailure = new UpdateFailure(byId("update-failure"));
/** @type {any[]} */
let items = [];
let readAt = 0;

/** Seconds that what is shown has aged since the service read it. @param {any} item */
const ageS = (item) => item.looked_age_s + (performance.now() - readAt) / 1000;

/** @param {any} item @returns {HTMLElement} */
function card(item) {
  const { standing } = item;
  const title = standing
    ? el("a", { class: "test-name", href: item.page, text: item.name })
    : el("span", { class: "test-name", text: item.name });
  const head = el("div", { class: "test-head" }, el("h2", {}, title));
  const element = el("li", { class: "card test" }, head);
  element.dataset.test = item.test;
  element.dataset.state = standing?.state ?? item.state;
  if (!standing) {
    head.append(
      chip({ label: ABSENT[item.state] ?? item.state, icon: "dash", tone: item.state === "no_data" ? "info" : "warn" }),
    );
    element.append(
      el("p", { text: item.detail }),
      el("p", { class: "test-remedy", text: item.remedy }),
      el("p", { class: "quiet small", text: item.source }),
    );
    return element;
  }
  head.append(chip(STATES[standing.state]), chip(RECORDER[standing.recorder]));
  if (standing.highest_priority)
    head.append(
      chip({
        ...PRIORITIES[standing.highest_priority],
        label:
          `${standing.active_alarms} alarm${standing.active_alarms > 1 ? "s" : ""}, highest priority ` +
          `${standing.highest_priority}`,
      }),
    );
  if (standing.paused) head.append(chip({ label: "Paused", icon: "pause", tone: "warn" }));
  const positions = standing.positions.map((/** @type {any} */ positionInfo) =>
    el("li", {}, el("span", { class: "quiet", text: positionInfo.position }), " ", chip(STATES[positionInfo.state])),
  );
  element.append(
    el(
      "p",
      {},
      el("span", { class: "badge", text: standing.rig_label }),
      ` hour ${hour(standing.now_h)} of ${hour(standing.end_h)} h on the ${standing.clock} clock`,
    ),
    el("ul", { class: "test-positions", "aria-label": `${standing.positions.length} positions` }, ...positions),
    el("p", { class: "tile-age" }),
    el("p", { class: "quiet small", text: item.source }),
  );
  element.dataset.stale = String(standing.stale);
  return element;
}

function show() {
  const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest("[data-test]"))?.dataset.test;
  root.replaceChildren(...items.map(card));
  if (focused) /** @type {HTMLElement | null} */ (root.querySelector(`[data-test="${focused}"] a`))?.focus();
  const shown = items.filter((item) => item.standing).length;
  setText(
    byId("summary"),
    `${items.length} tests${shown < items.length ? `, ${items.length - shown} not available` : ""}`,
  );
  tick();
}

function tick() {
  for (const item of items) {
    const age = root.querySelector(`[data-test="${item.test}"] .tile-age`);
    if (!age) continue;
    const { standing } = item;
    const set = standing.last_set_index === null ? "" : `Set ${standing.last_set_index} · `;
    setText(age, set + ageText(standing, { ...standing, data_h: standing.last_set_h }, ageS(item)));
  }
}

async function read() {
  if (document.hidden) return;
  try {
    ({ items } = await get("/tests"));
    readAt = performance.now();
    updateFailure.clear();
    show();
  } catch (error) {
    updateFailure.fail(/** @type {Error} */ (error), readAt);
  }
}

/** Read regularly, each time after the last answer. */
async function poll() {
  await read();
  setTimeout(poll, REFRESH_MS);
}

/** @type {Theme} */
const theme = new Theme(
  () => "",
  () => theme.show(),
  () => {},
);
theme.show();
setInterval(tick, TICK_MS);
document.addEventListener("visibilitychange", read);
await waitForLogin();
await poll();
