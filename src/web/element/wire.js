// Handles as the site gives them, in the form of a warp object, and those of the page's document.

import { METHODS } from "../methods.js";
import { pinOf } from "../twist.js";

/**
 * What the element does not do has one value. The objects of methods are beside these.
 *
 * @typedef {Partial<Page.Warp> & {
 *   strength?: number, units?: string, [method: string]: unknown,
 * }} GivenWarp
 */

/** The only values of fields that the element has no other way for. */
const ONLY = { units: "px", align: "none" };

/** @type {(value: unknown) => value is Page.Place} */
const isPlace = (value) =>
  Array.isArray(value) && value.length === 2 && value.every((c) => Number.isFinite(c));

/**
 * The positions of a handle. Throws a TypeError that says which handle has no valid form.
 *
 * @param {unknown} handle
 * @param {string} where
 * @returns {Page.Place[]}
 */
function placesOf(handle, where) {
  if (isPlace(handle)) return [[...handle]];
  if (Array.isArray(handle) && handle.length > 1 && handle.every(isPlace))
    return handle.map((place) => [...place]);
  throw new TypeError(`${where}: a handle is [x, y], or a list of two or more of these`);
}

/**
 * The positions of handles, p or q.
 *
 * @param {unknown} handles
 * @param {Page.Which} which
 */
export function placesIn(handles, which) {
  if (!Array.isArray(handles)) throw new TypeError(`${which}: a list of handles`);
  return handles.map((handle, k) => placesOf(handle, `${which}[${k}]`));
}

/** @type {(p: Page.Place[][], q: Page.Place[][]) => boolean} */
export const fits = (p, q) =>
  p.length === q.length && p.every((places, k) => places.length === q[k].length);

/**
 * @param {Page.Place[][]} p
 * @param {Page.Place[][]} q of the same shape
 * @param {number[]} [weights]
 * @param {number} [mass]
 * @param {number[]} [depth]
 * @returns {Page.Handle[]}
 */
export function handlesOf(p, q, weights, mass, depth) {
  return p.map((rest, k) => ({
    id: k + 1,
    ...(pinOf(rest, q[k], weights?.[k], mass) ?? {
      p: rest,
      q: q[k],
      ...(weights && { weight: weights[k] }),
    }),
    ...(depth?.[k] && { depth: depth[k] }),
  }));
}

/**
 * What of a warp object a document has besides its handles. Throws a TypeError that names a field
 * which the element cannot follow.
 *
 * @param {GivenWarp} warp
 * @returns {Partial<Page.Document>}
 */
export function settingsOf(warp) {
  const { method, alpha, smoothing, point_mass: mass, metric, mask, coincident } = warp;
  const { folds, grid, output } = warp;
  for (const [field, only] of Object.entries(ONLY))
    if ((warp[field] ?? only) !== only)
      throw new TypeError(`${field}: the element has only "${only}"`);
  if (method !== undefined && !METHODS.some(({ name }) => name === method))
    throw new TypeError(`method: one of ${METHODS.map(({ name }) => name).join(", ")}`);
  if (!["report", "remove", undefined].includes(folds))
    throw new TypeError('folds: "report" or "remove"');
  const given = METHODS.filter(({ name, object }) => object && warp[name] !== undefined);
  const own = Object.fromEntries(
    given.map(({ name }) => [name, /** @type {Record<string, number>} */ (warp[name])]),
  );
  const cell = typeof grid === "object" && "cell" in grid ? grid.cell : grid;
  return {
    ...(method !== undefined && { method }),
    ...(alpha !== undefined && { alpha }),
    ...(smoothing !== undefined && { smoothing }),
    ...(mass !== undefined && { mass }),
    ...(given.length && { own }),
    ...(metric !== undefined && { metric }),
    ...(mask?.threshold !== undefined && { threshold: mask.threshold }),
    ...(coincident !== undefined && { coincident }),
    ...(folds !== undefined && { folds }),
    ...(cell !== undefined && { grid: /** @type {Page.Grid} */ (cell) }),
    ...output,
  };
}
