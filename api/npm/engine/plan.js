// Handles at rest.

import { Held, inUse } from "./instance.js";
import { Pose } from "./pose.js";

/** @typedef {[number, number] | [number, number][]} Handle a point, a line or a polyline; px */
/** @typedef {"rigid" | "similarity" | "affine" | "tps" | "global_affine" | "beier_neely" | "arap"} Method */
/**
 * The fields of a warp object that poses share; api/openapi.json describes them.
 *
 * @typedef {{
 *   size: [width: number, height: number],
 *   method?: Method, metric?: "euclidean" | "geodesic", outline?: Outline,
 *   mask?: { threshold?: number }, alpha?: number, weights?: number[], depth?: number[],
 *   point_mass?: number, smoothing?: number,
 *   align?: "none" | "rigid" | "similarity" | "affine", units?: "px" | "normalized",
 *   grid?: object | "auto" | "pixel", coincident?: object, folds?: "report" | "reject" | "remove",
 *   beier_neely?: { a?: number, b?: number, p?: number }, arap?: { cell?: number },
 * }} PlanOptions
 */
/**
 * @typedef {Omit<PlanOptions, "size" | "method" | "outline"> & {
 *   p?: Handle[], q?: Handle[], strength?: number, method?: Method | "auto",
 *   output?: Record<string, unknown>, [field: string]: unknown,
 * }} WarpObject
 */

/** What is visible of an image: handles of `metric: "geodesic"` and `method: "arap"` act through it alone. */
export class Outline extends Held {}

/** Handles at rest on an image of a size. Immutable; as many poses as you like. */
export class Plan extends Held {
  #handles;

  /**
   * @internal
   * @param {import("./instance.js").Instance} instance
   * @param {number} number
   * @param {number} handles
   */
  constructor(instance, number, handles) {
    super(instance, number);
    this.#handles = handles;
  }

  /** The number of handles. */
  get handles() {
    return this.#handles;
  }

  /**
   * The mesh of moved handles.
   *
   * @param {Handle[]} q as many as `p`, and of the same kinds
   * @param {number} [strength] the part of the way from `p` to `q`, -10 to 10
   * @returns {Pose}
   */
  pose(q, strength = 1) {
    const [instance, number] = inUse(this);
    return new Pose(instance, instance.make("pose", number, instance.putJson({ q, strength })));
  }
}
