// The baseline of the charted position: its life, how far it can be trusted, and a person's orders about it.

import { confirmed } from "./control/confirm.js";
import { may } from "./control/session.js";
import { el } from "./dom.js";
import { NONE, fixed, significant, utc } from "./format.js";
import { chip } from "./icons.js";
import { giveBy } from "./commands.js";

/** @type {Record<string, import("./icons.js").Look>} */
const LOOKS = {
  collecting: { word: "Collecting", icon: "dots", tone: "info" },
  unusable: { word: "No limits: nothing is judged", icon: "triangle", tone: "warn" },
  proposed: { word: "Proposed: nobody has signed it", icon: "triangle", tone: "warn" },
  approved: { word: "Approved", icon: "check", tone: "good" },
  retired: { word: "Retired", icon: "stop", tone: "" },
};
const NOTE = { name: "note", label: "Reason (everybody sees it)" };

/** @type {Record<string, (sets: number[]) => string>} */
const FOUND = {
  group: (sets) => `sets ${sets.join(", ")} lie together, away from the others`,
  outlier: (sets) => `set ${sets[0]} lies alone, away from the others`,
  trend: () => "a trend over the whole baseline",
};

/** @param {any} row of /baselines */
function whose(row) {
  if (row.state === "retired") return `retired by ${row.retired_by}, ${utc(row.retired_utc)}: ${row.retired_because}`;
  if (row.state !== "approved") return "";
  return `${row.approval === "automatic" ? "automatically: nobody signed it" : `by ${row.approval}`}, ${utc(row.approved_utc)}`;
}

/** It is frozen, without limits. @param {any} row of /baselines */
const unusable = (row) => row.state !== "collecting" && row.state !== "retired" && row.limit_reason !== null;

/** @param {any} readiness of a baseline */
function promise({ false_alarms_per_sensor_year, rate_guaranteed, why_not_guaranteed }) {
  return `${significant(false_alarms_per_sensor_year)} a year by the chart, ${rate_guaranteed ? "promised" : `not promised: ${why_not_guaranteed}`}`;
}

/** What its readiness says, each with its name. @param {any} row of /baselines @returns {[string, string][]} */
function facts(row) {
  const { readiness, temperature_c } = row;
  const range = `${row.first_set_index} to ${row.last_set_index}`;
  if (row.state === "collecting") return [["Sets", `${row.n_sets} of ${1 + row.last_set_index - row.first_set_index} so far (${range})`], ["Complete", `with the set of hour ${fixed(row.to_h, 1)}, ${utc(row.to_utc)}`]];
  if (readiness === null) return [["Sets", `${row.n_sets}, of ${range}`], ["Limit", row.limit_reason ?? NONE]];
  const named = readiness.named.map((/** @type {any} */ one) => FOUND[one.kind]?.(one.set_indices) ?? one.kind);
  return [
    ["Sets", `${readiness.n} of ${range}, ${readiness.n_left_out} left out`],
    ["Worth", `${fixed(readiness.n_eff, 0)} independent sets (correlation from set to set ${fixed(readiness.phi_pooled, 2)})`],
    ["Tails", `${fixed(readiness.tail, 2)} times those of normal sets`],
    ["Stands out", named.join("; ") || "nothing"],
    ["Temperature", temperature_c === null ? "not measured" : `${fixed(temperature_c[0], 1)} to ${fixed(temperature_c[1], 1)} °C`],
    ["False alarms", promise(readiness)],
    ...(readiness.advice ? [/** @type {[string, string]} */ (["Size", readiness.advice])] : []),
  ];
}

export class BaselineCard {
  /** @param {HTMLElement} root @param {(text: string) => void} onTrouble */
  constructor(root, onTrouble) {
    this.root = root;
    this.onTrouble = onTrouble;
    this.position = "";
    this.shown = this.offered = "";
    this.head = el("h2");
    this.state = el("span", { class: "bare" });
    this.body = el("div");
    this.orders = el("p", { class: "chips" });
    this.root.replaceChildren(el("summary", {}, this.head, " ", this.state), this.body, this.orders);
  }

  /** @param {string} position that the charts show @param {any[]} rows its baselines of the API, the present one last @param {boolean} listens somebody carries orders out */
  update(position, rows, listens) {
    const row = rows.at(-1);
    this.position = position;
    this.root.hidden = row === undefined;
    const shown = JSON.stringify(rows);
    if (row === undefined || shown + listens === this.shown) return;
    this.shown = shown + listens;
    this.head.textContent = `Baseline of ${position}`;
    this.state.replaceChildren(chip(LOOKS[unusable(row) ? "unusable" : row.state]));
    const readouts = facts(row).map(([term, value]) => el("div", {}, el("dt", { text: term }), el("dd", { text: value })));
    const earlier = rows.slice(0, -1).map((one) => el("li", { text: `${one.name}, ${whose(one)}` }));
    this.body.replaceChildren(
      el("p", { class: "quiet", text: [row.name, whose(row)].filter(Boolean).join(", ") }),
      el("dl", { class: "readouts long" }, ...readouts),
      ...(earlier.length ? [el("p", { class: "quiet small", text: "Before it:" }), el("ul", { class: "small" }, ...earlier)] : []),
    );
    // Another set is no reason to take a button away from under a finger.
    const offered = JSON.stringify([row.name, row.state, listens]);
    if (offered !== this.offered) this.orders.replaceChildren(...(listens ? this.buttons(row) : []));
    this.offered = offered;
  }

  /** @param {any} row the present baseline */
  buttons(row) {
    const { position } = this;
    const approve = {
      title: `Sign the baseline of ${position}`,
      says: [`You say that the wall and the transducer at ${position} were healthy in sets ${row.first_set_index} to ${row.last_set_index}. Later sets are judged by them, as they are already.`],
      word: `Sign ${row.name}`,
      fields: [{ ...NOTE, label: "Note (everybody sees it)" }],
    };
    const renew = {
      title: `Another baseline for ${position}`,
      says: [
        `${row.name} is retired for good. Another one is collected from the next planned set on, and until it is complete nothing judges the wall at ${position}: not the chart, and no limit.`,
        "It learns the wall as it is. Damage that is there by then counts as healthy.",
      ],
      word: `Retire ${row.name}`,
      fields: [{ ...NOTE, input: { required: true } }],
    };
    return [
      ...(row.state === "proposed" && !unusable(row) && may("approve_baseline") ? [this.button("Sign it", "approve_baseline", approve)] : []),
      ...(may("renew_baseline") ? [this.button("Begin another one", "renew_baseline", renew)] : []),
    ];
  }

  /** @param {string} word @param {string} kind @param {import("./control/confirm.js").Question} question */
  button(word, kind, question) {
    const asked = /** @type {HTMLButtonElement} */ (el("button", { class: "button ghost", type: "button", text: word }));
    asked.addEventListener("click", async () => {
      const { position } = this;
      const given = await confirmed(question);
      if (given !== null) await giveBy(asked, kind, { position, ...given }, this.onTrouble);
    });
    return asked;
  }
}
