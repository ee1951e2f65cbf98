// Export what is on the screen: as files of the API, and as Python that reads the same data.

import { BASE, get } from "./api.js";
import { copyButton } from "./copy.js";
import { el } from "./dom.js";

/**
 * @typedef {object} Offer
 * @property {string} description content of the files, where it differs from the screen
 * @property {{title: string, path: string, as?: string}[]} files below /api/v1; as: the format of a single file, else
 *   all formats of the API
 * @property {string[]} python lines in which `test` is the opened test
 */

const FORMAT_LABELS = /** @type {Record<string, string>} */ ({
  csv: "CSV",
  parquet: "Parquet",
  arrow: "Arrow",
  npz: "NPZ",
  mat: "MATLAB",
  h5: "HDF5",
});
/** @type {string[]} formats that this service writes; empty until they are read */
let formats = [];

/**
 * Return the table of the API, and the method of the client, that has a feature.
 *
 * @param {string} field
 * @param {string} method
 */
const tableOf = (field, method) =>
  method === "pulse_echo"
    ? "thickness"
    : ["distance_squared", "mewma_statistic"].includes(field)
      ? "assessments"
      : field === "thickness_m"
        ? "wall"
        : "features";

/** Return a text or number as a Python literal. @param {string | number} value */
const literal = (value) => JSON.stringify(value);

/** @param {[number, number] | null} span @returns {Record<string, number>} */
const hoursOf = (span) => (span ? { from_h: span[0], to_h: span[1] } : {});

/** @param {Record<string, number>} range as arguments of the client */
const keywords = (range) => Object.entries(range).map(([name, value]) => `${name}=${literal(value)}`);

/** @param {Record<string, string | number>} args */
const query = (args) =>
  new URLSearchParams(Object.entries(args).map(([name, value]) => [name, String(value)])).toString();

/**
 * Offer the data of a chart: each set of these hours, also where the chart shows bins.
 *
 * @param {{fields: string[], method: string, methods?: Record<string, string>, positions: string[]}} taken `methods` of
 *   positions with another one
 * @param {[number, number] | null} span null: the complete test
 * @returns {Offer}
 */
export function chartOffer({ fields, method, methods, positions }, span) {
  const tables = positions.map((position) => tableOf(fields[0], methods?.[position] ?? method));
  const range = hoursOf(span);
  const files = positions.map((position, k) => ({
    title: `Position ${position}`,
    path: `/tables/${tables[k]}?${query({ position, ...range, fields: fields.join(",") })}`,
  }));
  const args = ["position", ...keywords(range)].join(", ");
  const columns = ["due_h", ...fields, "quality"].map(literal).join(", ");
  const readers = positions.map((position, k) => `${literal(position)}: test.${tables[k]}`).join(", ");
  return {
    description: "Every set of these hours, in SI units.",
    files,
    python: [
      "data = {",
      `    position: read(${args})[[${columns}]]`,
      `    for position, read in {${readers}}.items()`,
      "}",
    ],
  };
}

/**
 * Offer a report for printing, and complete tables.
 *
 * @param {[number, number] | null} span null: the complete test
 * @returns {Offer}
 */
export function testOffer(span) {
  const range = hoursOf(span);
  const tables = {
    assessments: "Assessments",
    features: "Features",
    thickness: "Thickness",
    wall: "Wall thickness by waves",
    sets: "Sets",
    baselines: "Baselines",
    alarms: "Alarms",
  };
  const confirmations = query({ ...range, purpose: "confirmation" });
  return {
    description: span ? "These hours, every position." : "The whole test, every position.",
    files: [
      { title: "Printable report", path: `/report?${query(range)}`, as: "HTML" },
      ...Object.entries(tables).map(([table, title]) => ({ title, path: `/tables/${table}?${query(range)}` })),
      { title: "Assessments of confirmation sets", path: `/tables/assessments?${confirmations}` },
      { title: "Features of confirmation sets", path: `/tables/features?${confirmations}` },
    ],
    python: [
      `assessments = test.assessments(${keywords(range).join(", ")})`,
      `features = test.features(${keywords(range).join(", ")})`,
    ],
  };
}

/**
 * Offer the waveforms of a set.
 *
 * @param {string} position
 * @param {import("./format.js").SetKey} set
 * @param {string} file of the set as the API names it
 * @returns {Offer}
 */
export function setOffer(position, set, file) {
  const waveforms = `/waveforms/${encodeURIComponent(position)}`;
  return {
    description: "The accepted waveforms in V; the set's own file has counts and calibration of every position.",
    files: [
      ...(typeof set === "number"
        ? [{ title: "Waveforms", path: `${waveforms}?first_set=${set}&last_set=${set}` }]
        : []),
      { title: "File of the set", path: `/files/${file.split("/").at(-1)}`, as: "HDF5" },
    ],
    python: [`waves = test.waveforms(${literal(position)}, ${literal(set)})`],
  };
}

/** @param {string[]} lines @returns {string} */
function program(lines) {
  return [
    "# pip install 'solimon[client]'; set SOLIMON_TOKEN if the service needs a token",
    "from daq_service import client",
    "",
    `with client.open(${literal(location.origin + BASE)}) as test:`,
    ...lines.map((line) => `    ${line}`),
    "",
  ].join("\n");
}

/**
 * Return a button that opens a list of files and the same as Python.
 *
 * @param {string} of what is exported, for screen readers
 * @param {() => Offer | null} offer called when it opens; null: there is nothing yet
 * @returns {HTMLElement}
 */
export function exportMenu(of, offer) {
  const box = el("div", { class: "export-box" });
  const root = /** @type {HTMLDetailsElement} */ (
    el(
      "details",
      { class: "export" },
      el("summary", { class: "button ghost small", "aria-label": `Export: ${of}`, text: "Export" }),
      box,
    )
  );
  root.addEventListener("toggle", () => root.open && void fill(box, offer()));
  root.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !root.open) return;
    event.preventDefault();
    close(root);
    /** @type {HTMLElement} */ (root.firstElementChild).focus();
  });
  root.addEventListener("focusout", (event) => {
    // Without a new focus the user has left the window itself.
    if (event.relatedTarget && !root.contains(/** @type {Node} */ (event.relatedTarget))) close(root);
  });
  return root;
}

/** @param {HTMLDetailsElement} root */
function close(root) {
  root.open = false;
}

/** @param {HTMLElement} box @param {Offer | null} offer */
async function fill(box, offer) {
  if (offer === null) return box.replaceChildren(el("p", { text: "There is nothing to export yet." }));
  try {
    if (!formats.length) ({ formats } = await get("/tables"));
  } catch (error) {
    return box.replaceChildren(
      el("p", { role: "alert", text: `The formats cannot be read: ${/** @type {Error} */ (error).message}` }),
    );
  }
  const link = (/** @type {string} */ path, /** @type {string} */ text, /** @type {string} */ title) =>
    el("a", { href: `${BASE}/api/v1${path}`, "aria-label": `${title} as ${text}`, text });
  const files = offer.files.map(({ title, path, as }) => {
    const links = as
      ? [link(path, as, title)]
      : formats.map((format) =>
          link(`${path}${path.includes("?") ? "&" : "?"}format=${format}`, FORMAT_LABELS[format] ?? format, title),
        );
    return el("div", {}, el("p", { text: title }), el("p", { class: "export-files" }, ...links));
  });
  const text = program(offer.python);
  const code = /** @type {HTMLTextAreaElement} */ (
    el("textarea", {
      class: "field",
      readonly: true,
      rows: String(text.split("\n").length),
      "aria-label": "The same in Python",
      spellcheck: "false",
      wrap: "off",
    })
  );
  code.value = text;
  const copy = copyButton(
    "Copy as Python",
    () => text,
    () => {
      code.select();
      return "Selected: copy it with Ctrl+C";
    },
  );
  return box.replaceChildren(
    el("p", { class: "quiet small", text: offer.description }),
    ...files,
    code,
    el("p", { class: "export-files" }, copy.button, copy.status),
  );
}
