// Show the audit log to administrators, newest entry first: author, operation, time, source and result.

import { get } from "../api.js";
import { button, byId, el, setText } from "../dom.js";
import { utc } from "../format.js";
import { isAllowed } from "./session.js";

const PAGE = 50;
const PAUSE_KINDS = ["pause", "resume"];
const LOGIN_KINDS = ["enter", "log_in", "log_out", "create_token", "revoke_token"];
const COMMAND_KINDS = [
  ...PAUSE_KINDS,
  "disable",
  "enable",
  "stop",
  "finish_now",
  "supply_on",
  "supply_off",
  "trust_clock",
  "acknowledge_alarm",
  "create_command",
];
/** @type {[string, string[]][]} */
const KINDS = [
  ["All", []],
  ["Pauses", PAUSE_KINDS],
  ["Commands", COMMAND_KINDS],
  ["Logins and tokens", LOGIN_KINDS],
];
/**
 * Start and end of each range in days before the last midnight, by this browser's clock.
 *
 * @type {[string, number | null, number | null][]}
 */
const RANGES = [
  ["Any time", null, null],
  ["Today", 0, null],
  ["Yesterday", 1, 0],
  ["7 days", 6, null],
];
const RESULTS = ["any result", "accepted", "done", "rejected", "failed"];
const COLUMNS = ["Time", "Author", "Role", "Source", "Operation", "Result"];

/** @param {number | null} days back from the last midnight */
function midnight(days) {
  if (days === null) return null;
  const now = new Date();
  return new Date(now.getFullYear(), now.getMonth(), now.getDate() - days).toISOString();
}

/** @param {any} item @returns {HTMLElement} */
function row(item) {
  const args = Object.entries(item.arguments)
    .filter(([name, value]) => name !== "request_id" && value !== null && value !== "")
    .map(([name, value]) => `${name}: ${value}`);
  const omitted = item.left_out ? `; ${item.left_out} earlier rejections are not listed` : "";
  const cells = [
    el("time", { datetime: item.utc, title: item.utc, text: utc(item.utc) }),
    item.author || "Unknown",
    item.role || "Not logged in",
    item.source,
    [item.what, ...args].join(", "),
    `${[item.result, item.outcome, item.reason].filter(Boolean).join(": ")}${omitted}`,
  ];
  return el("tr", {}, ...cells.map((cell) => el("td", {}, cell)));
}

export class Audit {
  constructor() {
    this.root = /** @type {HTMLDetailsElement} */ (byId("audit"));
    this.root.hidden = !isAllowed("list_audit");
    this.author = /** @type {HTMLInputElement} */ (
      el("input", {
        class: "field small",
        type: "search",
        placeholder: "any author",
        maxlength: "80",
        "aria-label": "Author",
      })
    );
    this.result = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": "Result" }));
    for (const [k, text] of RESULTS.entries()) this.result.append(el("option", { value: k === 0 ? "" : text, text }));
    this.status = el("p", { class: "quiet small", role: "status" });
    this.body = el("tbody");
    this.olderButton = button("Older", () => this.read(this.cursor));
    this.kind = this.choice(
      "Kind",
      KINDS.map(([word]) => word),
    );
    this.range = this.choice(
      "When",
      RANGES.map(([word]) => word),
    );
    /** @type {string | null} */
    this.cursor = null;
    this.requestNumber = 0;
    const table = el(
      "table",
      {},
      el("thead", {}, el("tr", {}, ...COLUMNS.map((text) => el("th", { scope: "col", text })))),
      this.body,
    );
    byId("audit-body").append(
      el("div", { class: "chips" }, this.kind.root, this.range.root, this.author, this.result),
      this.status,
      el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": "Audit log" }, table),
      this.olderButton,
    );
    this.root.addEventListener("toggle", () => this.root.open && void this.read(null));
    this.author.addEventListener("change", () => void this.read(null));
    this.result.addEventListener("change", () => void this.read(null));
  }

  /** Return a group of buttons of which one is chosen. @param {string} label @param {string[]} labels */
  choice(label, labels) {
    const root = el("span", { class: "chips", role: "group", "aria-label": label });
    const group = { root, chosen: 0 };
    const choose = (/** @type {HTMLButtonElement} */ pressed) => {
      group.chosen = buttons.indexOf(pressed);
      for (const one of buttons) one.setAttribute("aria-pressed", String(one === pressed));
      void this.read(null);
    };
    const buttons = labels.map((text, k) => button(text, choose, { "aria-pressed": String(k === 0) }));
    root.append(...buttons);
    return group;
  }

  /** @param {string | null} cursor null: from the newest on */
  async read(cursor) {
    const [, from, to] = RANGES[this.range.chosen];
    const filters = {
      author: this.author.value.trim(),
      what: KINDS[this.kind.chosen][1].join(","),
      result: this.result.value,
      from_utc: midnight(from),
      to_utc: midnight(to),
      cursor,
    };
    const query = new URLSearchParams({ limit: String(PAGE) });
    for (const [name, value] of Object.entries(filters)) if (value) query.set(name, value);
    const requestNumber = ++this.requestNumber;
    setText(this.status, "Loading");
    try {
      const page = await get(`/audit?${query}`);
      if (requestNumber !== this.requestNumber) return; // another filter was chosen in the meantime
      if (cursor === null) this.body.replaceChildren();
      this.body.append(...page.items.map(row));
      this.cursor = page.next_cursor;
      this.olderButton.hidden = this.cursor === null;
      const count = this.body.childElementCount;
      const rest = this.cursor === null ? "" : "; older entries exist";
      setText(this.status, `${count || "Nothing"} found${rest}. Days are those of this browser's time zone.`);
    } catch (error) {
      if (requestNumber === this.requestNumber)
        setText(this.status, `Audit log not available: ${/** @type {Error} */ (error).message}`);
    }
  }
}
