// The choosers of methods and metrics: a button with a small picture for each choice.

import { find } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg";
/** The pictures are this large; their grid has this many cells. */
const [SIDE, CELLS] = [32, 4];

/**
 * What a method does to a square from -1 to 1 when its upper right corner is pulled: a sketch, not
 * its map. Methods without a row have the last one.
 * @type {Record<string, (x: number, y: number) => [number, number]>}
 */
const SKETCHES = {
  rigid: (x, y) => turned(x, y, 0.5 * (1 - y) * x, 1),
  similarity: (x, y) => turned(x, y, 0.22 * (1 - y), 0.8 + 0.12 * (x - y)),
  affine: (x, y) => [0.8 * x - 0.3 * y, 0.85 * y],
  tps: (x, y) => [x * 0.8 + 0.35 * bump(x, y), y * 0.8 - 0.35 * bump(x, y)],
  global_affine: (x, y) => turned(0.95 * x, 0.65 * y, -0.3, 1),
  // The upper half stays as it is, the lower one bends like a leg.
  arap: (x, y) => turned(x, y, -0.5 * Math.max(0, y), 0.9),
  beier_neely: (x, y) => [0.85 * x + 0.28 * Math.sin(2.4 * y), 0.9 * y],
  "": (x, y) => [0.9 * x + 0.25 * (1 - y) * Math.abs(x), 0.9 * y + 0.1 * x * x],
};

/** @type {(x: number, y: number) => number} */
const bump = (x, y) => Math.exp(-3 * ((x - 0.3) ** 2 + (y + 0.3) ** 2));
/** @type {(x: number, y: number, angle: number, scale: number) => [number, number]} */
function turned(x, y, angle, scale) {
  const [cos, sin] = [0.85 * scale * Math.cos(angle), 0.85 * scale * Math.sin(angle)];
  return [cos * x - sin * y, sin * x + cos * y];
}

/**
 * The picture of a method: a square grid, deformed.
 * @param {string} name
 */
export function methodPicture(name) {
  const sketch = SKETCHES[name] ?? SKETCHES[""];
  const lines = [...Array(CELLS + 1).keys()].map((k) => (2 * k) / CELLS - 1);
  const steps = [...Array(13).keys()].map((k) => k / 6 - 1);
  /** @type {(places: [number, number][]) => string} */
  const path = (places) =>
    `M${places.map((place) => place.map((c) => ((1 + 0.88 * c) * (SIDE / 2)).toFixed(1)).join(" ")).join("L")}`;
  const along = lines.map((at) => path(steps.map((t) => sketch(t, at))));
  const down = lines.map((at) => path(steps.map((t) => sketch(at, t))));
  return [{ d: [...along, ...down].join("") }];
}

/**
 * The pictures of the metrics: two legs, and the way from a handle on one to the other.
 * @type {Record<string, Record<string, string>[]>}
 */
export const METRIC_PICTURES = {
  euclidean: [
    { d: "M4 4H28V28H19V13H13V28H4Z" },
    { d: "M8 24H24", "stroke-dasharray": "2 2" },
    { d: "M5.5 24a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0 -5 0", class: "handle" },
  ],
  geodesic: [
    { d: "M4 4H28V28H19V13H13V28H4Z" },
    { d: "M8 24L12 11H20L24 24", "stroke-dasharray": "2 2" },
    { d: "M5.5 24a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0 -5 0", class: "handle" },
  ],
};

/**
 * Adds a choice to a chooser.
 * @param {"methods" | "metrics"} chooser
 * @param {"method" | "metric"} kind
 * @param {{ name: string, title: string, sentence: string }} choice
 * @param {Record<string, string>[]} picture
 * @param {() => void} choose
 */
export function offer(chooser, kind, { name, title, sentence }, picture, choose) {
  const { document } = window;
  const [label, button, words] = ["label", "input", "span"].map((tag) =>
    document.createElement(tag),
  );
  const input = /** @type {HTMLInputElement} */ (button);
  Object.assign(input, { id: `${kind}-${name}`, type: "radio", name: kind, value: name });
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${SIDE} ${SIDE}`);
  svg.setAttribute("aria-hidden", "true");
  for (const attributes of picture) {
    const path = document.createElementNS(SVG, "path");
    for (const [key, value] of Object.entries(attributes)) path.setAttribute(key, value);
    svg.append(path);
  }
  words.textContent = title;
  label.title = sentence;
  label.append(input, svg, words);
  find(chooser).append(label);
  input.addEventListener("change", choose);
  return input;
}
