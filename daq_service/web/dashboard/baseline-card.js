// Show the baseline of the charted position: its lifecycle, its quality and its commands.

import { askConfirmation } from "./control/confirm.js";
import { isAllowed } from "./control/session.js";
import { button, el } from "./dom.js";
import { NONE, fixed, significant, utc } from "./format.js";
import { chip } from "./icons.js";
import { sendByButton } from "./commands.js";

/** @type {Record<string, import("./icons.js").Look>} */
const STATES = {
  collecting: { label: "Collecting", icon: "dots", tone: "info" },
  unusable: { label: "No limits", icon: "triangle", tone: "warn" },
  proposed: { label: "Awaiting approval", icon: "triangle", tone: "warn" },
  approved: { label: "Approved", icon: "check", tone: "good" },
  not_reviewed: { label: "Not reviewed", icon: "dash", tone: "info" },
  retired: { label: "Retired", icon: "stop", tone: "" },
};
const NOTE = { name: "note", label: "Reason (visible to all)" };

/** @type {Record<string, (sets: number[]) => string>} */
const ANOMALY_TEXTS = {
  group: (sets) => `sets ${sets.join(", ")} form a separate group`,
  outlier: (sets) => `set ${sets[0]} is an outlier`,
  trend: () => "a trend over the complete baseline",
};

/** @param {any} row of /baselines */
function approvalText(row) {
  const { retired_by: author, retired_reason: reason } = row;
  if (row.state === "retired") return `retired by ${author}, ${utc(row.retired_utc)}: ${reason}`;
  if (row.state !== "approved") return "";
  return (
    `${row.approval === "automatic" ? "approved automatically, not reviewed" : `approved by ${row.approval}`}, ` +
    `${utc(row.approved_utc)}`
  );
}

/** Whether it is frozen but has no limits. @param {any} row of /baselines */
const unusable = (row) => row.state !== "collecting" && row.state !== "retired" && row.limit_reason !== null;

/** Return the key of its state in `STATES`. @param {any} row of /baselines */
function stateOf(row) {
  if (unusable(row)) return "unusable";
  return row.state === "approved" && !reviewed(row) ? "not_reviewed" : row.state;
}

/** Whether a person has approved it. @param {any} row of /baselines */
const reviewed = (row) => row.state === "approved" && row.approval !== "automatic";

/**
 * Return the false-alarm rate; until a person approves the baseline, also why it is not verified and what to do.
 *
 * @param {any} row of /baselines
 * @returns {[string, string][]}
 */
function falseAlarms(row) {
  const { false_alarms_per_sensor_year: rate, rate_verified, rate_not_verified_reason, advice } = row.baseline_quality;
  const design = `design rate ${significant(rate)} per transducer-year`;
  if (rate_verified) return [["False alarms", `${design}, verified`]];
  if (reviewed(row)) return [["False alarms", design]];
  return [
    ["False alarms", `${design}, not verified: ${rate_not_verified_reason}`],
    ...(advice ? [/** @type {[string, string]} */ (["Size", advice])] : []),
    ["What to do", "Approve this baseline, or renew it with more sets."],
  ];
}

/**
 * Return the facts of a baseline and its quality, each with its name.
 *
 * @param {any} row of /baselines
 * @returns {[string, string][]}
 */
function facts(row) {
  const { baseline_quality: quality, temperature_c } = row;
  const range = `${row.first_set_index} to ${row.last_set_index}`;
  if (row.state === "collecting")
    return [
      ["Sets", `${row.n_sets} of ${1 + row.last_set_index - row.first_set_index} (${range})`],
      ["Complete", `hour ${fixed(row.to_h, 1)}, ${utc(row.to_utc)}`],
    ];
  if (quality === null)
    return [
      ["Sets", `${row.n_sets}, of ${range}`],
      ["Limit", row.limit_reason ?? NONE],
    ];
  const anomalies = quality.named.map(
    (/** @type {any} */ one) => ANOMALY_TEXTS[one.kind]?.(one.set_indices) ?? one.kind,
  );
  return [
    ["Sets", `${quality.n} of ${range}, ${quality.n_left_out} left out`],
    [
      "Effective size",
      `${fixed(quality.n_eff, 0)} independent sets (lag-1 autocorrelation ${fixed(quality.phi_pooled, 2)})`,
    ],
    ["Tail factor", fixed(quality.tail, 2)],
    ["Anomalies", anomalies.join("; ") || "none"],
    [
      "Temperature",
      temperature_c === null ? "not measured" : `${fixed(temperature_c[0], 1)} to ${fixed(temperature_c[1], 1)} °C`,
    ],
    ...falseAlarms(row),
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
    this.commandButtons = el("p", { class: "chips" });
    this.root.replaceChildren(el("summary", {}, this.head, " ", this.state), this.body, this.commandButtons);
  }

  /**
   * @param {string} position that the charts show
   * @param {any[]} rows its baselines from the API, the current one last
   * @param {boolean} acceptsCommands whether a recorder carries out commands
   */
  update(position, rows, acceptsCommands) {
    const row = rows.at(-1);
    this.position = position;
    this.root.hidden = row === undefined;
    const shown = JSON.stringify(rows);
    if (row === undefined || shown + acceptsCommands === this.shown) return;
    this.shown = shown + acceptsCommands;
    this.head.textContent = `Baseline of ${position}`;
    this.state.replaceChildren(chip(STATES[stateOf(row)]));
    const readouts = facts(row).map(([term, value]) =>
      el("div", {}, el("dt", { text: term }), el("dd", { text: value })),
    );
    const earlier = rows.slice(0, -1).map((one) => el("li", { text: `${one.name}, ${approvalText(one)}` }));
    this.body.replaceChildren(
      el("p", { class: "quiet", text: [row.name, approvalText(row)].filter(Boolean).join(", ") }),
      el("dl", { class: "readouts long" }, ...readouts),
      ...(earlier.length
        ? [el("p", { class: "quiet small", text: "Earlier baselines:" }), el("ul", { class: "small" }, ...earlier)]
        : []),
    );
    // A new set must not replace a button that a finger may be about to press.
    const offered = JSON.stringify([row.name, row.state, acceptsCommands]);
    if (offered !== this.offered) this.commandButtons.replaceChildren(...(acceptsCommands ? this.buttons(row) : []));
    this.offered = offered;
  }

  /** @param {any} row the present baseline */
  buttons(row) {
    const { position } = this;
    const approve = {
      title: `Approve baseline of ${position}`,
      paragraphs: [
        `You confirm that wall and transducer at ${position} were healthy in sets ` +
          `${row.first_set_index} to ${row.last_set_index}. Later sets are compared with them.`,
      ],
      submitLabel: `Approve ${row.name}`,
      fields: [{ ...NOTE, label: "Note (visible to all)" }],
    };
    const renew = {
      title: `Renew baseline of ${position}`,
      paragraphs: [
        `${row.name} is retired for good. A new baseline starts with the next scheduled set. Until it is complete, ` +
          `the wall at ${position} is not monitored.`,
        "Measure the wall first: damage that exists by then counts as healthy.",
      ],
      submitLabel: `Retire ${row.name}`,
      fields: [{ ...NOTE, input: { required: true } }],
    };
    return [
      ...(row.state === "proposed" && !unusable(row) && isAllowed("approve_baseline")
        ? [this.button("Approve", "approve_baseline", approve)]
        : []),
      ...(isAllowed("renew_baseline") ? [this.button("Renew baseline", "renew_baseline", renew)] : []),
    ];
  }

  /** @param {string} label @param {string} kind @param {import("./control/confirm.js").Question} question */
  button(label, kind, question) {
    const { position } = this;
    const ask = async (/** @type {HTMLButtonElement} */ pressed) => {
      const answers = await askConfirmation(question);
      if (answers !== null) await sendByButton(pressed, kind, { position, ...answers }, this.onTrouble);
    };
    return button(label, ask, { class: "button ghost" });
  }
}
