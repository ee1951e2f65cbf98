// Show the alarm list: unacknowledged alarms first. Evidence, history and guidance open in a dialog.

import { AlarmFilter } from "./alarm-filter.js";
import { Announcer } from "./announcer.js";
import { get, post } from "./api.js";
import { askConfirmation } from "./control/confirm.js";
import { authorName, isAllowed } from "./control/session.js";
import { DetailsDialog } from "./details-dialog.js";
import { button, el, setText } from "./dom.js";
import { hour, setKey, setName, utc } from "./format.js";
import { Handover, changeText } from "./handover.js";
import { PRIORITIES, chip } from "./icons.js";
import { awaitResult, sendCommand } from "./commands.js";
import { AlarmEvidence, setLink } from "./alarm-evidence.js";
import { askOutOfService, askShelving, suppressedText } from "./shelve.js";

const WAITING = new Set(["unacknowledged", "returned_unacknowledged"]);
/** Kinds that a confirmation set can help to diagnose. */
const CONFIRMABLE = new Set(["wall_change", "transducer_change"]);
const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
/** @type {Record<string, string>} */
const STATE_LABELS = {
  unacknowledged: "unacknowledged",
  acknowledged: "acknowledged",
  returned_unacknowledged: "returned to normal, unacknowledged",
  normal: "returned to normal",
};
const NOTE = {
  name: "note",
  label: "Note",
  first: true,
  input: { required: true, maxlength: "2000", pattern: ".*\\S.*" },
};

/** @param {any} alarm */
const isWaiting = (alarm) => WAITING.has(alarm.state) && !alarm.suppressed;
/** @param {any} alarm */
const isSuppressed = (alarm) => Boolean(alarm.suppressed) && alarm.state !== "normal";
/** @param {string} markdown */
const plain = (markdown) => markdown.replace(/[`*]/g, "");

export class SolimonAlarms extends HTMLElement {
  constructor() {
    super();
    /** @type {any[]} */
    this.items = [];
    /** @type {Map<number, {key: string, text: string}>} button and status of our commands, by alarm */
    this.commandStatus = new Map();
    /** @type {import("./alarm-evidence.js").Host} */
    this.host = /** @type {any} */ (null);
    /** Whether the test has finished and nothing strikes. */
    this.testEnded = false;
    /** @type {any[] | undefined} guidance for each kind */
    this.guidance = undefined;
    this.handover = new Handover(() => (this.details.renew(), this.render()));
    this.announcer = new Announcer();
    this.filter = new AlarmFilter(() => this.render());
    this.details = new DetailsDialog();
    /** Evidence that was opened last. @type {AlarmEvidence | null} */
    this.evidence = null;
    this.count = el("p", { "aria-live": "polite", text: "Loading" });
    this.visit = button("Since my last visit", () => this.showVisit(), { "data-focus": "visit", hidden: true });
    this.acknowledgeAll = button("Acknowledge all", () => this.acknowledgeShown(), {
      "data-focus": "all",
      hidden: true,
    });
    this.suppressed = el("ul", { class: "suppressed-list", "aria-label": "Shelved and out of service" });
    this.list = el("ul", { class: "alarm-list" });
    this.none = el("p", { class: "no-alarms", text: "" });
  }

  connectedCallback() {
    this.setAttribute("role", "region");
    this.setAttribute("aria-labelledby", "alarms-title");
    const { toggle, silence } = this.announcer;
    this.append(
      el(
        "div",
        { class: "card-head" },
        el("div", {}, el("h2", { id: "alarms-title", text: "Alarms" }), this.count),
        el("div", { class: "card-actions" }, silence, toggle),
      ),
      this.suppressed,
      this.filter.root,
      el("div", { class: "alarm-filter" }, this.acknowledgeAll, this.visit),
      this.none,
      this.list,
      this.details.dialog,
    );
  }

  /** @param {any[]} items */
  update(items) {
    const before = new Map(this.items.map((item) => [item.id, item.changed_utc + item.suppressed]));
    for (const { id, changed_utc, suppressed } of items)
      if (before.get(id) !== changed_utc + suppressed) this.commandStatus.delete(id);
    this.items = [...items].sort(
      (a, b) =>
        Number(isWaiting(b)) - Number(isWaiting(a)) ||
        Number(b.state !== "normal") - Number(a.state !== "normal") ||
        Number(Boolean(a.suppressed)) - Number(Boolean(b.suppressed)) ||
        RANK[/** @type {"critical"} */ (a.priority)] - RANK[/** @type {"critical"} */ (b.priority)] ||
        b.raised_h - a.raised_h,
    );
    const waiting = items.filter(isWaiting).length;
    const suppressed = items.filter(isSuppressed);
    setText(
      this.count,
      items.length
        ? `${waiting} unacknowledged, ` +
            (suppressed.length ? `${suppressed.length} shelved or out of service, ` : "") +
            `${items.length} in this test`
        : "None",
    );
    this.suppressed.replaceChildren(
      ...suppressed.map((alarm) => el("li", { text: `${alarm.headline}: ${suppressedText(alarm)}` })),
    );
    this.suppressed.hidden = suppressed.length === 0;
    this.filter.offer(items);
    this.filter.root.hidden = items.length === 0;
    this.dataset.count = String(items.length);
    setText(this.none, "No alarm has been raised in this test.");
    this.none.hidden = items.length > 0;
    this.list.hidden = items.length === 0;
    this.announcer.update(items);
    this.details.renew();
    this.render();
  }

  /** Return the alarms that the filter shows. */
  shown() {
    const changed = this.handover.alarms();
    return this.items.filter((item) => this.filter.shows(item, changed));
  }

  render() {
    const active = /** @type {HTMLElement | null} */ (document.activeElement);
    const focused = active?.dataset?.focus;
    const shown = this.shown();
    this.list.replaceChildren(...shown.map((item) => this.item(item)));
    if (focused) /** @type {HTMLElement | null} */ (this.list.querySelector(`[data-focus="${focused}"]`))?.focus();
    const waiting = shown.filter(isWaiting);
    const critical = waiting.filter(({ priority }) => priority === "critical").length;
    this.acknowledgeAll.hidden = waiting.length === critical || !isAllowed("acknowledge_alarm");
    setText(
      this.acknowledgeAll,
      `Acknowledge all in view (${waiting.length - critical}${critical ? `, not ${critical} critical` : ""})`,
    );
    const summary = this.handover.summary();
    this.visit.hidden = !summary;
    setText(this.visit, `Since my last visit: ${summary}`);
  }

  /** @param {any} alarm @returns {HTMLElement} */
  item(alarm) {
    const status = this.commandStatus.get(alarm.id);
    const { headline, id, position } = alarm;
    const open = alarm.state !== "normal";
    const foot = el("div", { class: "alarm-foot" });
    /**
     * Add a button if the user's role allows its action.
     *
     * @param {string} key
     * @param {string} action
     * @param {string} text
     * @param {(report: (text: string) => void) => Promise<unknown>} send
     * @param {string} [kind] of the button
     */
    const offer = (key, action, text, send, kind = "button ghost small") => {
      if (!isAllowed(action)) return;
      const attributes = { class: kind, disabled: status !== undefined, "data-focus": `${key}-${id}` };
      const label = status?.key === key ? status.text : text;
      foot.append(
        button(label, () => this.send(id, key, send), { ...attributes, "aria-label": `${label}: ${headline}` }),
      );
    };
    /** @param {string} key @param {string} text @param {() => void} act */
    const detail = (key, text, act) =>
      foot.append(
        button(text, act, { class: "link", "data-focus": `${key}-${id}`, "aria-label": `${text}: ${headline}` }),
      );
    /** @param {any} args @param {string} kind @param {(text: string) => void} report */
    const command = async (args, kind, report) => args && sendCommand(kind, args, report);
    const main = "button small";
    if (WAITING.has(alarm.state)) {
      offer("ack", "acknowledge_alarm", "Acknowledge", (report) => this.acknowledge(id, "", report), main);
      offer("note", "acknowledge_alarm", "Acknowledge with note", (report) => this.acknowledgeWithNote(alarm, report));
    }
    if (alarm.suppressed) {
      const [kind, text] =
        alarm.suppressed === "shelved" ? ["unshelve_alarm", "Unshelve"] : ["return_to_service", "Return to service"];
      offer("restore", kind, text, (report) => sendCommand(kind, { alarm_id: id }, report), main);
    } else if (open) {
      offer("shelve", "shelve_alarm", "Shelve", async (report) =>
        command(await askShelving(alarm), "shelve_alarm", report),
      );
      offer("out", "take_out_of_service", "Take out of service", async (report) =>
        command(await askOutOfService(alarm), "take_out_of_service", report),
      );
    }
    detail("now", "What to do", () => this.showGuidance(alarm));
    detail("evidence", "Evidence", () => this.showEvidence(alarm));
    detail("history", "History", () => this.showHistory(alarm));
    if (alarm.kind === "clock_unverified" && (alarm.state === "unacknowledged" || alarm.state === "acknowledged"))
      offer("trust", "trust_clock", "Trust clock", (report) => sendCommand("trust_clock", {}, report), main);
    if (CONFIRMABLE.has(alarm.kind) && open && !this.testEnded)
      offer("strike", "strike", "Take confirmation set", (report) => sendCommand("strike", { position }, report));
    const links = { "Open set": alarm.raised_set_index, "Open confirmation set": alarm.evidence?.confirmation };
    for (const [text, set] of Object.entries(links)) {
      if (position === null || set === null || set === undefined) continue;
      const key = typeof set === "object" ? setKey(set) : set;
      const attributes = {
        "data-focus": `${text}-${id}`,
        "aria-label": `Open ${setName(key)} of position ${position}`,
      };
      foot.append(setLink(position, key, text, attributes, this.host.open));
    }
    const at = `hour ${hour(alarm.raised_h)}`;
    const show = () => this.dispatchEvent(new CustomEvent("show-hour", { detail: { position, hour: alarm.raised_h } }));
    const hourButton = button(at, show, {
      class: "link",
      "data-focus": `hour-${id}`,
      "aria-label": `Show ${at} of ${position ?? "the test"} on the charts and the waterfall`,
    });
    const note = alarm.note ? `: ${alarm.note}` : "";
    const acknowledger = alarm.acknowledged_by ? ` by ${alarm.acknowledged_by}${note}` : "";
    const suppressed = alarm.suppressed ? `, ${suppressedText(alarm)}` : "";
    const item = el(
      "li",
      { class: "alarm" },
      el(
        "div",
        { class: "alarm-head" },
        chip(PRIORITIES[alarm.priority] ?? PRIORITIES.low),
        el("strong", {}, `${position ?? "System"} · `, hourButton),
        el("span", { class: "quiet", text: utc(alarm.raised_utc) }),
      ),
      el("p", { class: "alarm-message", text: headline }),
      el("p", {
        class: "quiet small",
        text: `${alarm.alarm_class} alarm, ${STATE_LABELS[alarm.state] ?? alarm.state}${acknowledger}${suppressed}`,
      }),
      foot,
    );
    item.dataset.alarm = String(id);
    item.dataset.open = String(open);
    return item;
  }

  /** Draw an open chart again, e.g. in the colors of another theme. */
  redraw() {
    this.evidence?.chart?.draw();
  }

  /** Update open evidence after new sets. */
  renew() {
    this.evidence?.renew();
  }

  /** @param {any} alarm */
  showEvidence(alarm) {
    const open = (/** @type {string} */ position, /** @type {import("./format.js").SetKey} */ set) => {
      this.details.dialog.close();
      this.host.open(position, set);
    };
    const evidence = (this.evidence = new AlarmEvidence(alarm, { ...this.host, open }));
    this.details.show(`Evidence: ${alarm.headline}`, evidence.root, () =>
      evidence.update(this.items.find(({ id }) => id === alarm.id) ?? alarm),
    );
  }

  /** Show the guidance of its kind. @param {any} alarm */
  showGuidance(alarm) {
    const text = el("div", { text: "Loading" });
    this.details.show(`What to do: ${alarm.headline}`, text);
    void this.read(text, async () => {
      const guidance = (this.guidance ??= /** @type {any[]} */ ((await get("/guidance")).items));
      const found = guidance.find(({ kind }) => kind === alarm.kind);
      if (!found) return [el("p", { text: "No guidance for this kind of alarm." })];
      const checks = found.checks.map((/** @type {string} */ step) => el("li", { text: plain(step) }));
      return [
        ...(alarm.action ? [el("p", {}, el("strong", { text: alarm.action }))] : []),
        el("p", { text: `Means: ${plain(found.meaning)}.` }),
        el("p", { text: `Does not mean: ${plain(found.limitations)}.` }),
        el("ol", {}, ...checks),
        el("p", { text: `Contact: ${plain(found.contact)}.` }),
      ];
    });
  }

  /** List all transitions, again after each change. @param {any} alarm */
  showHistory(alarm) {
    const list = el("ul", { text: "Loading" });
    const read = () =>
      this.read(list, async () =>
        (await get(`/alarms/${alarm.id}/history`)).items.map((/** @type {any} */ one) => {
          const author = one.author ? `by ${one.author}` : "";
          return el("li", {
            text: [utc(one.utc), changeText(one.kind), author, one.reason].filter(Boolean).join(" · "),
          });
        }),
      );
    this.details.show(`History: ${alarm.headline}`, list, () => void read());
    void read();
  }

  /** Show what is read, or why it cannot be. @param {HTMLElement} root @param {() => Promise<HTMLElement[]>} load */
  async read(root, load) {
    try {
      root.replaceChildren(...(await load()));
    } catch (error) {
      setText(root, /** @type {Error} */ (error).message);
    }
  }

  /** Show what happened since the last visit. */
  showVisit() {
    const content = el("div");
    const headline = (/** @type {number} */ id) => this.items.find((item) => item.id === id)?.headline ?? `Alarm ${id}`;
    const read = button("Mark as read", () => this.handover.markRead(), {});
    const renew = () => content.replaceChildren(this.handover.element(headline), read);
    renew();
    this.details.show("Since my last visit", content, renew);
  }

  /**
   * Send a command of an alarm: its buttons are disabled, and the pressed one shows the status.
   *
   * @param {number} id @param {string} key of the button
   * @param {(report: (text: string) => void) => Promise<unknown>} send
   */
  async send(id, key, send) {
    // The list keeps the status: it may replace the button while the command waits.
    const report = (/** @type {string} */ text) => {
      if (this.commandStatus.get(id)?.text === text) return;
      this.commandStatus.set(id, { key, text });
      this.render();
    };
    try {
      await send(report);
    } catch (error) {
      this.dispatchEvent(new CustomEvent("trouble", { detail: /** @type {Error} */ (error).message }));
    }
    this.commandStatus.delete(id);
    this.render();
  }

  /** Acknowledge with one note what the filter shows, but no critical alarm. */
  async acknowledgeShown() {
    const alarms = this.shown().filter((alarm) => isWaiting(alarm) && alarm.priority !== "critical");
    const answers = await askConfirmation({
      title: `Acknowledge ${alarms.length} alarms`,
      paragraphs: [
        ...alarms.map(({ headline }) => headline),
        "Critical alarms remain: acknowledge each of them by its own button.",
      ],
      submitLabel: "Acknowledge all",
      fields: [NOTE],
    });
    if (!answers) return;
    try {
      await authorName();
    } catch (error) {
      this.dispatchEvent(new CustomEvent("trouble", { detail: /** @type {Error} */ (error).message }));
      return;
    }
    for (const { id } of alarms) void this.send(id, "ack", (report) => this.acknowledge(id, answers.note, report));
  }

  /** @param {any} alarm @param {(text: string) => void} report */
  async acknowledgeWithNote(alarm, report) {
    const answers = await askConfirmation({
      title: "Acknowledge alarm",
      paragraphs: [alarm.headline, "The note is shown with the alarm and in its history."],
      submitLabel: "Acknowledge",
      fields: [NOTE],
    });
    if (answers) await this.acknowledge(alarm.id, answers.note, report);
  }

  /** @param {number} id @param {string} note @param {(text: string) => void} report */
  async acknowledge(id, note, report) {
    const author = await authorName();
    report("Sending");
    await awaitResult(await post(`/alarms/${id}/acknowledge`, { author, note }), report);
  }
}
