// Run the page of `solimon setup`: a live scope on canvas, and the question that also waits at the terminal.

import { byId, color, el, setText } from "./dom.js";

/** @typedef {{first_s: number, column_s: number, lowest_v: number[], highest_v: number[], range_v: number}} Envelope */
/** @typedef {{name: string, time_s: number | null, height_v: number | null}} Mark */
/**
 * @typedef {{range_v?: number, level_v?: number | null, marks?: Mark[], edges?: {name: string, time_s: number}[]}}
 *   Lines
 */
/** @typedef {{number: number, name: string, text: string, default: string, choices: string[]}} Question */

const KEPT = 12;
const PAUSE_MS = 100;
const MARGIN = { left: 52, right: 10, top: 10, bottom: 24 };

const live = /** @type {HTMLCanvasElement} */ (byId("live"));
const field = /** @type {HTMLInputElement} */ (byId("answer"));
/** @type {Envelope[]} */
let kept = [];
/** @type {{position: string | null, level_v: number | null}} */
let scope = { position: null, level_v: null };
let askedNumber = -1;
let strikes = 0;

/** @param {number} volts @param {number} half of the axis @param {number} height */
const yOf = (volts, half, height) => MARGIN.top + ((half - volts) / (2 * half)) * (height - MARGIN.top - MARGIN.bottom);

/**
 * @param {HTMLCanvasElement} canvas
 * @param {Envelope[]} envelopes oldest first; the newest is drawn on top, in full color
 * @param {Lines} lines
 */
function draw(canvas, envelopes, lines) {
  const ratio = devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  pen.scale(ratio, ratio);
  const newest = envelopes[envelopes.length - 1];
  let half = 1.1 * (lines.level_v ? Math.abs(lines.level_v) : 0);
  for (const envelope of envelopes)
    for (let k = 0; k < envelope.lowest_v.length; k += 1)
      half = Math.max(half, 1.1 * Math.abs(envelope.lowest_v[k]), 1.1 * Math.abs(envelope.highest_v[k]));
  const range = lines.range_v ?? newest.range_v;
  if (half > 0.3 * range) half = Math.max(half, 1.1 * range);
  const length = newest.lowest_v.length * newest.column_s;
  const inner = width - MARGIN.left - MARGIN.right;
  const xOf = (/** @type {number} */ time) => MARGIN.left + ((time - newest.first_s) / length) * inner;
  envelopes.forEach((envelope, index) => {
    pen.strokeStyle = color("--data");
    pen.globalAlpha = envelopes.length === 1 ? 1 : 0.08 + 0.92 * ((index + 1) / envelopes.length) ** 3;
    pen.beginPath();
    for (let k = 0; k < envelope.lowest_v.length; k += 1) {
      const x = xOf(envelope.first_s + k * envelope.column_s);
      pen.moveTo(x, yOf(envelope.highest_v[k], half, height));
      pen.lineTo(x, yOf(envelope.lowest_v[k], half, height) + 1);
    }
    pen.stroke();
  });
  pen.globalAlpha = 1;
  pen.font = '12px system-ui, "Liberation Sans", Arial, sans-serif';
  pen.fillStyle = color("--quiet");
  const level = (/** @type {number} */ volts, /** @type {number[]} */ dash, /** @type {string} */ paint, aside = 0) => {
    pen.strokeStyle = paint;
    pen.setLineDash(dash);
    pen.beginPath();
    pen.moveTo(MARGIN.left, yOf(volts, half, height));
    pen.lineTo(width - MARGIN.right, yOf(volts, half, height));
    pen.stroke();
    pen.fillText(`${Number(volts.toPrecision(3))} V`, 2, yOf(volts, half, height) + 4 - aside);
  };
  level(0, [], color("--line-strong"));
  level(half / 1.1, [], color("--grid"));
  if (range <= half) for (const end of [-range, range]) level(end, [8, 5], color("--limit"));
  if (lines.level_v) level(lines.level_v, [2, 3], color("--fit"), 12 * Math.sign(lines.level_v));
  pen.setLineDash([]);
  pen.fillText(`${(newest.first_s * 1e3).toFixed(2)} ms`, MARGIN.left, height - 6);
  pen.fillText(`${((newest.first_s + length) * 1e3).toFixed(2)} ms`, width - 70, height - 6);
  for (const edge of lines.edges ?? []) {
    pen.strokeStyle = color("--limit-other");
    pen.beginPath();
    pen.moveTo(xOf(edge.time_s), MARGIN.top);
    pen.lineTo(xOf(edge.time_s), height - MARGIN.bottom);
    pen.stroke();
    pen.fillText(edge.name, xOf(edge.time_s) + 3, MARGIN.top + 10);
  }
  for (const mark of lines.marks ?? []) {
    if (mark.time_s === null || mark.height_v === null) continue;
    pen.fillStyle = color("--fit");
    pen.beginPath();
    pen.arc(xOf(mark.time_s), yOf(mark.height_v, half, height), 4, 0, 2 * Math.PI);
    pen.fill();
    pen.fillStyle = color("--ink");
    pen.fillText(mark.name, xOf(mark.time_s) + 6, yOf(mark.height_v, half, height) - 6);
  }
}

/** @param {string} path @param {object} [body] @returns {Promise<any>} */
async function ask(path, body) {
  const options =
    body === undefined
      ? {}
      : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error((await answer.json()).detail);
  return answer.json();
}

/** @param {string} text */
async function sendAnswer(text) {
  const number = askedNumber;
  for (const button of byId("form").querySelectorAll("button")) button.disabled = true;
  try {
    await ask("/api/answer", { number, text });
  } catch (error) {
    setText(byId("state"), String(error instanceof Error ? error.message : error));
  }
}

/** @param {Question | null} question */
function show(question) {
  if (question === null) {
    setText(byId("question"), "Working");
    byId("form").hidden = true;
    askedNumber = -1;
    return;
  }
  if (question.number === askedNumber) return;
  askedNumber = question.number;
  byId("form").hidden = false;
  byId("form").dataset.name = question.name;
  setText(byId("question"), question.text);
  const buttons = question.choices.map((choice) => {
    const button = el("button", {
      class: choice === question.default ? "button" : "button ghost",
      type: "button",
      text: choice,
    });
    button.addEventListener("click", () => void sendAnswer(choice));
    return button;
  });
  byId("choices").replaceChildren(...buttons);
  field.hidden = byId("send").hidden = buttons.length > 0;
  field.value = question.default;
  /** @type {HTMLButtonElement} */ (byId("send")).disabled = false;
}

byId("form").addEventListener("submit", (event) => {
  event.preventDefault();
  void sendAnswer(field.value);
});

async function showStrike() {
  const newest = await ask("/api/strike");
  scope.level_v = newest.level_v ?? null;
  const strikeCanvas = /** @type {HTMLCanvasElement} */ (byId("strike"));
  strikeCanvas.dataset.strikes = String(strikes);
  /** @type {HTMLElement} */ (strikeCanvas.closest("section")).hidden = newest.strike === null && newest.shot !== null;
  if (newest.strike !== null) {
    const edges = [{ name: "coil off", time_s: newest.off_s }];
    if (newest.holdoff_s) edges.push({ name: "trigger enabled", time_s: newest.off_s + newest.holdoff_s });
    draw(strikeCanvas, [newest.strike], { level_v: newest.level_v, edges });
    strikeCanvas.setAttribute(
      "aria-label",
      `Strike, ${(newest.strike.lowest_v.length * newest.strike.column_s * 1e3).toFixed(0)} ms`,
    );
  }
  const shot = /** @type {HTMLCanvasElement} */ (byId("shot"));
  shot.dataset.strikes = String(strikes);
  if (newest.shot === null) return;
  draw(shot, [newest.shot], { range_v: newest.proposed_range_v, level_v: newest.level_v, marks: newest.marks });
  const markTexts = newest.marks.map((/** @type {Mark} */ mark) =>
    mark.height_v === null || mark.time_s === null
      ? `no ${mark.name}`
      : `${mark.name} ${mark.height_v.toFixed(2)} V at ${(mark.time_s * 1e6).toFixed(1)} µs`,
  );
  shot.setAttribute("aria-label", markTexts.join("; "));
  setText(byId("flags"), `${markTexts.join("; ")}; flags: ${newest.flags.join(", ") || "none"}`);
}

async function pollScope() {
  const { position, record: envelope, error } = await ask("/api/record", {});
  if (position !== scope.position) {
    kept = [];
    scope = { position, level_v: scope.level_v };
    setText(byId("live-title"), position === null ? "At rest, free running" : `${position} at rest, free running`);
    if (position !== null && envelope === null)
      setText(byId("live-title"), `${position}: the instrument records strikes only`);
  }
  if (error) setText(byId("state"), error);
  if (!envelope) return;
  kept = [...kept, envelope].slice(-KEPT);
  draw(live, kept, { level_v: scope.level_v });
  live.dataset.frames = String(Number(live.dataset.frames ?? 0) + 1);
  live.setAttribute(
    "aria-label",
    `${position} at rest, ${Number(Math.max(...envelope.highest_v).toPrecision(3))} V maximum; range ` +
      `±${envelope.range_v} V`,
  );
}

async function pollState() {
  for (;;) {
    const state = await ask("/api/state");
    setText(byId("log"), state.lines.join("\n"));
    if (state.done) {
      setText(byId("state"), "Done");
      byId("form").hidden = true;
      setText(
        byId("question"),
        state.lines.filter((/** @type {string} */ line) => line.includes("is written"))[0] ?? "Ended",
      );
      return;
    }
    setText(byId("state"), state.question === null ? "Working" : "Waiting for you");
    show(state.question);
    if (state.strikes !== strikes) {
      strikes = state.strikes;
      await showStrike();
    }
    await pollScope();
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
  }
}

pollState().catch(() => {
  setText(byId("state"), "Ended");
  byId("form").hidden = true;
  setText(byId("question"), "solimon setup has ended; see the terminal");
});
