// Who asked for what, when, from where, and what came of it: the audit, the newest first, for administrators.

import { get } from "../api.js";
import { byId, el, setText } from "../dom.js";
import { may } from "./session.js";

const PAGE = 50;
const HOLDS = ["hold", "release"];
const DOORS = ["enter", "log_in", "log_out", "create_token", "revoke_token"];
const ORDERS = [...HOLDS, "retire", "reinstate", "stop", "finish_now", "supply_on", "supply_off", "trust_clock", "acknowledge_alarm", "create_command"];
/** @type {[string, string[]][]} */
const KINDS = [["Everything", []], ["Holds", HOLDS], ["Orders", ORDERS], ["Logins and tokens", DOORS]];
/** Days back from the last midnight at which a range begins and ends, by this browser's clock. @type {[string, number | null, number | null][]} */
const RANGES = [["Any time", null, null], ["Today", 0, null], ["Yesterday", 1, 0], ["7 days", 6, null]];
const RESULTS = ["any result", "accepted", "done", "refused", "failed"];
const HEADS = ["When", "Who", "Role", "From", "What", "Result"];

/** @param {number | null} days back from the last midnight */
function midnight(days) {
  if (days === null) return null;
  const now = new Date();
  return new Date(now.getFullYear(), now.getMonth(), now.getDate() - days).toISOString();
}

/** @param {any} item @returns {HTMLElement} */
function row(item) {
  const given = Object.entries(item.arguments)
    .filter(([name, value]) => name !== "request_id" && value !== null && value !== "")
    .map(([name, value]) => `${name}: ${value}`);
  const left = item.left_out ? `; ${item.left_out} refusals before it are not told` : "";
  const cells = [
    el("time", { datetime: item.utc, title: item.utc, text: new Date(item.utc).toLocaleString() }),
    item.who || "nobody known",
    item.role || "a stranger",
    item.source,
    [item.what, ...given].join(", "),
    `${[item.result, item.outcome, item.why].filter(Boolean).join(": ")}${left}`,
  ];
  return el("tr", {}, ...cells.map((cell) => el("td", {}, cell)));
}

export class Audit {
  constructor() {
    this.root = /** @type {HTMLDetailsElement} */ (byId("audit"));
    this.root.hidden = !may("list_audit");
    this.who = /** @type {HTMLInputElement} */ (el("input", { class: "field small", type: "search", placeholder: "anybody", maxlength: "80", "aria-label": "Who" }));
    this.result = /** @type {HTMLSelectElement} */ (el("select", { class: "field small", "aria-label": "Result" }));
    for (const [k, text] of RESULTS.entries()) this.result.append(el("option", { value: k === 0 ? "" : text, text }));
    this.said = el("p", { class: "quiet small", role: "status" });
    this.body = el("tbody");
    this.older = /** @type {HTMLButtonElement} */ (el("button", { class: "button ghost small", type: "button", text: "Older" }));
    this.kind = this.choice("Kind", KINDS.map(([word]) => word));
    this.range = this.choice("When", RANGES.map(([word]) => word));
    /** @type {string | null} */
    this.cursor = null;
    this.asked = 0;
    const table = el("table", {}, el("thead", {}, el("tr", {}, ...HEADS.map((text) => el("th", { scope: "col", text })))), this.body);
    byId("audit-body").append(
      el("div", { class: "chips" }, this.kind.root, this.range.root, this.who, this.result),
      this.said,
      el("div", { class: "table-wrap", tabindex: "0", role: "region", "aria-label": "Audit" }, table),
      this.older,
    );
    this.root.addEventListener("toggle", () => this.root.open && void this.read(null));
    this.who.addEventListener("change", () => void this.read(null));
    this.result.addEventListener("change", () => void this.read(null));
    this.older.addEventListener("click", () => void this.read(this.cursor));
  }

  /** One of several, as buttons. @param {string} label @param {string[]} words */
  choice(label, words) {
    const root = el("span", { class: "chips", role: "group", "aria-label": label });
    const made = { root, chosen: 0 };
    const buttons = words.map((text, k) => el("button", { class: "button ghost small", type: "button", "aria-pressed": String(k === 0), text }));
    for (const [k, button] of buttons.entries()) {
      button.addEventListener("click", () => {
        made.chosen = k;
        for (const [other, one] of buttons.entries()) one.setAttribute("aria-pressed", String(other === k));
        void this.read(null);
      });
    }
    root.append(...buttons);
    return made;
  }

  /** @param {string | null} cursor null: from the newest on */
  async read(cursor) {
    const [, from, to] = RANGES[this.range.chosen];
    const wanted = { who: this.who.value.trim(), what: KINDS[this.kind.chosen][1].join(","), result: this.result.value, from_utc: midnight(from), to_utc: midnight(to), cursor };
    const query = new URLSearchParams({ limit: String(PAGE) });
    for (const [name, value] of Object.entries(wanted)) if (value) query.set(name, value);
    const asked = ++this.asked;
    setText(this.said, "Reading");
    try {
      const page = await get(`/audit?${query}`);
      if (asked !== this.asked) return; // something else was chosen meanwhile
      if (cursor === null) this.body.replaceChildren();
      this.body.append(...page.items.map(row));
      this.cursor = page.next_cursor;
      this.older.hidden = this.cursor === null;
      const count = this.body.childElementCount;
      const rest = this.cursor === null ? "" : "; there is more before that";
      setText(this.said, `${count || "Nothing"} found${rest}. Times are this computer's.`);
    } catch (error) {
      if (asked === this.asked) setText(this.said, `The audit cannot be read: ${/** @type {Error} */ (error).message}`);
    }
  }
}
