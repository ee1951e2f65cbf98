// The REST side: JSON in, problem details as errors, and a deadline for every answer.

const DEADLINE_MS = 15_000;
/** Entries of a trend at most: beyond, an entry is a bin of sets. A chart is hardly wider. */
const POINTS = 1000;

/** Where the page's test is, of a service that has several; empty: the service has one test, or this is the list. */
export const BASE = /^\/tests\/[^/]+(?=\/)/.exec(location.pathname)?.[0] ?? "";

export class ProblemError extends Error {
  /** @param {number} status @param {{type?: string, detail?: string, hint?: string}} problem */
  constructor(status, problem) {
    super(problem.detail ?? `HTTP ${status}`);
    this.status = status;
    this.type = problem.type ?? "about:blank";
    this.hint = problem.hint ?? "";
  }
}

/** @param {Response} response */
async function answer(response) {
  const body = await response.json();
  if (!response.ok) throw new ProblemError(response.status, body);
  return body;
}

/**
 * Ask and read the answer, or fail once nobody may be expected to answer any more.
 *
 * @template T
 * @param {string} address @param {RequestInit} request @param {(response: Response) => Promise<T>} read
 */
async function ask(address, request, read) {
  const control = new AbortController();
  const timer = setTimeout(() => control.abort(new Error(`no answer within ${DEADLINE_MS / 1000} s`)), DEADLINE_MS);
  try {
    return await read(await fetch(address, { ...request, signal: control.signal }));
  } finally {
    clearTimeout(timer);
  }
}

/** Answers that came with the page, by address: whoever asks first has them. @type {Map<string, any>} */
const brought = new Map(Object.entries(JSON.parse(document.getElementById("answers")?.textContent ?? "{}")).map(([path, answered]) => [BASE + path, answered]));

/** What came with the page and nobody has asked for yet. @param {string} path of the test */
export function broughtAlong(path) {
  return brought.get(BASE + path);
}

/** @param {string} address @returns {Promise<any>} */
async function json(address) {
  const answered = brought.get(address);
  brought.delete(address);
  return answered ?? ask(address, { headers: { Accept: "application/json" } }, answer);
}

/** @param {string} path below /api/v1 @param {string} [base] of another test; empty: the service @returns {Promise<any>} */
export async function get(path, base = BASE) {
  return json(`${base}/api/v1${path}`);
}

/** @param {string} path below /api/v1, of binary content @returns {Promise<ArrayBuffer>} */
export async function octets(path) {
  return ask(`${BASE}/api/v1${path}`, {}, async (response) => (response.ok ? response.arrayBuffer() : answer(response)));
}

/**
 * Columns of a position over the test; of many sets by bins (`bin_sets` above 1).
 *
 * @param {string} position @param {string[] | undefined} fields undefined: all
 * @param {{from_h?: number, to_h?: number}} [range] @param {string} [base] of another test
 */
export async function trend(position, fields, range = {}, base = BASE) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries({ fields, points: POINTS, ...range })) if (value !== undefined) query.set(name, String(value));
  return get(`/trends/${position}?${query}`, base);
}

/** Whether anything is stored yet; asked so because a browser reports every 503 as an error. */
export async function hasData() {
  return (await json(`${BASE}/healthz`)).data === true;
}

/** @param {string} path @param {object} body @returns {Promise<any>} */
export async function post(path, body) {
  const headers = { "Content-Type": "application/json" };
  return ask(`${BASE}/api/v1${path}`, { method: "POST", headers, body: JSON.stringify(body) }, answer);
}

/** @param {string} path @returns {Promise<any>} */
export async function remove(path) {
  return ask(`${BASE}/api/v1${path}`, { method: "DELETE" }, answer);
}

/** All pages of a listing. @param {string} path @returns {Promise<any[]>} */
export async function all(path) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(cursor ? `${path}${path.includes("?") ? "&" : "?"}cursor=${encodeURIComponent(cursor)}` : path);
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor);
  return items;
}
