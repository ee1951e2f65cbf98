// Draw small swatches of what a chart shows.

const SVG = "http://www.w3.org/2000/svg";
const SHAPES = [
  "M14 5a3 3 0 1 1-6 0a3 3 0 1 1 6 0z",
  "M8.3 2.3h5.4v5.4H8.3z",
  "M11 1.4l3.3 6.3H7.7z",
  "M11 8.6l3.3-6.3H7.7z",
];
/** @type {Record<string, string>} */
const STROKED = { line: "M1 5h20", dashed: "M1 5h5M9 5h5M17 5h4", cross: "M8 2l6 6M14 2l-6 6", ring: SHAPES[0] };

/**
 * @param {string} color custom property
 * @param {number | "line" | "dashed" | "diamond" | "cross" | "ring"} kind of mark; a number: that shape of points
 * @param {number[]} [dash]
 */
export function swatch(color, kind, dash) {
  const svg = document.createElementNS(SVG, "svg");
  for (const [name, value] of [
    ["viewBox", "0 0 22 10"],
    ["width", "22"],
    ["height", "10"],
    ["aria-hidden", "true"],
  ])
    svg.setAttribute(name, value);
  const path = document.createElementNS(SVG, "path");
  const stroked = typeof kind === "string" && STROKED[kind];
  path.setAttribute("d", stroked || (typeof kind === "number" ? SHAPES[kind % SHAPES.length] : "M11 1l4 4l-4 4l-4-4z"));
  path.setAttribute("fill", stroked ? "none" : `var(${color})`);
  if (stroked) {
    path.setAttribute("stroke", `var(${color})`);
    path.setAttribute("stroke-width", kind === "ring" ? "1.4" : "2");
    if (dash) path.setAttribute("stroke-dasharray", dash.join(" "));
  }
  svg.append(path);
  return svg;
}
