// The REST side: JSON in, problem details as errors.

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

/** @param {string} path below /api/v1 @returns {Promise<any>} */
export async function get(path) {
  return answer(await fetch(`/api/v1${path}`, { headers: { Accept: "application/json" } }));
}

/** Whether anything is stored yet; asked so because a browser reports every 503 as an error. */
export async function hasData() {
  return (await answer(await fetch("/healthz"))).data === true;
}

/** @param {string} path @param {object} body @returns {Promise<any>} */
export async function post(path, body) {
  return answer(
    await fetch(`/api/v1${path}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    }),
  );
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
