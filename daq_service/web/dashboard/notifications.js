// Show the receivers of notifications: state, test message and log. Hidden where there is none.

import { get, post } from "./api.js";
import { isAllowed } from "./control/session.js";
import { button, el, setText } from "./dom.js";
import { duration, utc } from "./format.js";
import { chip } from "./icons.js";

const POLL_MS = 10_000;
const LOG_LINES = 50;

/** @type {Record<string, import("./icons.js").Look>} */
const STATES = {
  idle: { label: "Ready", icon: "check", tone: "good" },
  waiting: { label: "Waiting to send", icon: "dots", tone: "info" },
  failing: { label: "Retrying", icon: "triangle", tone: "warn" },
  dead: { label: "Unreachable", icon: "link", tone: "alarm" },
};

/** @param {any} receiver of /notifications */
function lastSuccess(receiver) {
  return receiver.last_sent_utc === null
    ? "none since the service started"
    : `${utc(receiver.last_sent_utc)}, ${duration(receiver.last_sent_age_s)} ago`;
}

/** @param {any} beat */
function heartbeat(beat) {
  if (beat === null) return "not configured";
  const states = /** @type {Record<string, string>} */ ({
    off: "none yet",
    ok: "accepted",
    failing: "not accepted",
    withheld: "withheld",
  });
  const last = beat.last_utc ? `, last ${utc(beat.last_utc)}` : "";
  const { result: response } = beat;
  return `${states[beat.state]}${last}${beat.state === "ok" ? "" : ` ${response}`}`;
}

/** @param {any} receiver */
function trouble(receiver) {
  if (receiver.failing_since_utc === null) return "";
  return (
    `Since ${utc(receiver.failing_since_utc)}: ${receiver.last_failure}. Messages wait and are sent again ` +
    "until they expire."
  );
}

class Receiver {
  /** @param {any} receiver @param {() => void} changed */
  constructor(receiver, changed) {
    this.name = receiver.name;
    this.state = el("p", { class: "environment-name" });
    this.values = Object.fromEntries(["Last success", "Waiting", "Heartbeat"].map((term) => [term, el("dd")]));
    this.trouble = el("p", { role: "status" });
    this.result = el("p", { class: "quiet small", role: "status" });
    this.button = button(`Send test message to ${this.name}`, () => this.#test(changed), {
      class: "button ghost",
      hidden: !isAllowed("test_receiver"),
    });
    const readouts = Object.entries(this.values).map(([term, value]) => el("div", {}, el("dt", { text: term }), value));
    this.element = el(
      "div",
      { class: "environment-group" },
      this.state,
      el("dl", { class: "readouts" }, ...readouts),
      this.button,
      this.trouble,
      this.result,
    );
    this.shownState = "";
  }

  /** @param {any} receiver */
  update(receiver) {
    if (this.shownState !== receiver.state) {
      this.shownState = receiver.state;
      this.state.replaceChildren(
        el("strong", { text: this.name }),
        chip(STATES[receiver.state]),
        el("span", { class: "quiet small", text: `${receiver.kind}, ${receiver.address}` }),
      );
    }
    setText(this.values["Last success"], lastSuccess(receiver));
    setText(this.values.Waiting, String(receiver.waiting));
    setText(this.values.Heartbeat, heartbeat(receiver.heartbeat));
    setText(this.trouble, trouble(receiver));
  }

  /** @param {() => void} changed */
  async #test(changed) {
    this.button.disabled = true;
    setText(this.result, "Sending");
    try {
      const { ok, took_s, result: response } = await post(`/notifications/${this.name}/test`, {});
      setText(
        this.result,
        `${ok ? "Test message accepted" : "Test message not accepted"} after ${took_s.toFixed(1)} s: ${response}`,
      );
    } catch (error) {
      setText(this.result, /** @type {Error} */ (error).message);
    }
    this.button.disabled = false;
    this.button.focus();
    changed();
  }
}

export class Notifications {
  /** @param {HTMLElement} root @param {(error: Error) => void} fail */
  constructor(root, fail) {
    this.root = root;
    this.fail = fail;
    /** @type {Map<string, Receiver>} */
    this.receivers = new Map();
    this.status = el("p", { role: "status" });
    this.rows = el("tbody");
    this.log = el("details", {}, el("summary", { text: "Delivery log" }), this.#table());
    this.log.addEventListener("toggle", () => this.#readLog());
  }

  /** Read the state now and then regularly, if there is a receiver. */
  async start() {
    const answer = await get("/notifications");
    if (!answer.receivers.length) return;
    for (const receiver of answer.receivers)
      this.receivers.set(receiver.name, new Receiver(receiver, () => this.#readLog()));
    const heading = el("h2", { id: "notifications-title", text: "Notifications" });
    this.root.append(heading, this.status, ...[...this.receivers.values()].map((one) => one.element), this.log);
    this.root.hidden = false;
    this.#show(answer);
    setInterval(() => document.hidden || this.#read(), POLL_MS);
  }

  async #read() {
    try {
      this.#show(await get("/notifications"));
    } catch (error) {
      this.fail(/** @type {Error} */ (error));
    }
  }

  /** @param {any} answer */
  #show(answer) {
    setText(this.status, answer.sending ? "" : `This service sends nothing: ${answer.not_sending_reason}`);
    for (const receiver of answer.receivers) this.receivers.get(receiver.name)?.update(receiver);
  }

  #table() {
    const head = ["Time", "Receiver", "Event", "Result", "Event numbers"].map((text) =>
      el("th", { scope: "col", text }),
    );
    const table = el(
      "table",
      {},
      el("caption", { text: `The latest ${LOG_LINES}` }),
      el("thead", {}, el("tr", {}, ...head)),
      this.rows,
    );
    return el(
      "div",
      { class: "table-wrap", tabindex: "0", role: "region", "aria-label": "Delivery log, table" },
      table,
    );
  }

  async #readLog() {
    if (!(/** @type {HTMLDetailsElement} */ (this.log).open)) return;
    try {
      const { items } = await get(`/notifications/log?limit=${LOG_LINES}`);
      const cells = (/** @type {any} */ { utc: time, receiver, what, result: response, event_ids }) => [
        utc(time),
        receiver,
        what.replace("_", " "),
        response,
        event_ids.join(", "),
      ];
      this.rows.replaceChildren(
        ...items.map((/** @type {any} */ row) => el("tr", {}, ...cells(row).map((text) => el("td", { text })))),
      );
    } catch (error) {
      this.fail(/** @type {Error} */ (error));
    }
  }
}
