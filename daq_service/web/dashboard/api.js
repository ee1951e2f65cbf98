// Request the REST API: parse JSON, raise problem details as errors, and set a deadline for each answer.

const DEADLINE_MS = 15_000;
/** Maximum entries of a trend; with more sets an entry is a bin. A chart is hardly wider. */
const POINTS = 1000;

/** Base path of the page's test in a service with several; empty: the service has one test, or this is the list. */
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
async function parseResponse(response) {
  const body = await response.json();
  if (!response.ok) throw new ProblemError(response.status, body);
  return body;
}

/**
 * Send a request and read the answer, or fail at the deadline.
 *
 * @template T
 * @param {string} address @param {RequestInit} request @param {(response: Response) => Promise<T>} read
 */
async function fetchWithDeadline(address, request, read) {
  const controller = new AbortController();
  const timer = setTimeout(() => controller.abort(new Error(`no answer within ${DEADLINE_MS / 1000} s`)), DEADLINE_MS);
  try {
    return await read(await fetch(address, { ...request, signal: controller.signal }));
  } finally {
    clearTimeout(timer);
  }
}

/** Answers embedded in the page, by address: the first request takes them. @type {Map<string, any>} */
const embedded = new Map(
  Object.entries(JSON.parse(document.getElementById("answers")?.textContent ?? "{}")).map(([path, embeddedValue]) => [
    BASE + path,
    embeddedValue,
  ]),
);

/** Return an embedded answer that no request has taken yet. @param {string} path of the test */
export function embeddedAnswer(path) {
  return embedded.get(BASE + path);
}

/** @param {string} address @returns {Promise<any>} */
async function json(address) {
  const embeddedValue = embedded.get(address);
  embedded.delete(address);
  return embeddedValue ?? fetchWithDeadline(address, { headers: { Accept: "application/json" } }, parseResponse);
}

/**
 * @param {string} path below /api/v1
 * @param {string} [base] of another test; empty: the service
 * @returns {Promise<any>}
 */
export async function get(path, base = BASE) {
  return json(`${base}/api/v1${path}`);
}

/** @param {string} path below /api/v1, of binary content @returns {Promise<ArrayBuffer>} */
export async function getBytes(path) {
  return fetchWithDeadline(`${BASE}/api/v1${path}`, {}, async (response) =>
    response.ok ? response.arrayBuffer() : parseResponse(response),
  );
}

/**
 * Read columns of a position over the test; many sets come in bins (`bin_sets` above 1).
 *
 * @param {string} position @param {string[] | undefined} fields undefined: all
 * @param {{from_h?: number, to_h?: number}} [range] @param {string} [base] of another test
 */
export async function trend(position, fields, range = {}, base = BASE) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries({ fields, points: POINTS, ...range }))
    if (value !== undefined) query.set(name, String(value));
  return get(`/trends/${position}?${query}`, base);
}

/**
 * Return whether anything is stored yet, and before that what the recorder does. Not by a route that answers 503: a
 * browser reports each of these as an error.
 *
 * @returns {Promise<{data: boolean, recorder: string, doing: string | null}>}
 */
export async function getLiveness() {
  return json(`${BASE}/healthz`);
}

/** @param {string} path @param {object} body @returns {Promise<any>} */
export async function post(path, body) {
  const headers = { "Content-Type": "application/json" };
  return fetchWithDeadline(
    `${BASE}/api/v1${path}`,
    { method: "POST", headers, body: JSON.stringify(body) },
    parseResponse,
  );
}

/** @param {string} path @returns {Promise<any>} */
export async function remove(path) {
  return fetchWithDeadline(`${BASE}/api/v1${path}`, { method: "DELETE" }, parseResponse);
}

/** Read all pages of a listing. @param {string} path @returns {Promise<any[]>} */
export async function getAllPages(path) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(
      cursor ? `${path}${path.includes("?") ? "&" : "?"}cursor=${encodeURIComponent(cursor)}` : path,
    );
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor);
  return items;
}
