// What follows from one pose: pixels, labels, positions, a mesh.

import { Held, inUse, numberIn } from "./instance.js";

/**
 * RGBA, not premultiplied: an ImageData, or an object with the same members where that class is
 * missing.
 *
 * @typedef {{
 *   width: number, height: number, data: Uint8ClampedArray<ArrayBuffer>, colorSpace?: PredefinedColorSpace,
 * }} DrawnPixels
 */
/** @typedef {{ width: number, height: number, data: ArrayBufferView, colorSpace?: PredefinedColorSpace }} Pixels */
/** @typedef {Uint8Array | Uint16Array | Uint32Array} LabelArray */
/** @typedef {{ width: number, height: number, data: LabelArray }} Labels */
/**
 * `output` of a warp object without what files alone have; api/openapi.json describes the fields.
 *
 * @typedef {{
 *   canvas?: "same" | "fit" | { x: number, y: number, width: number, height: number },
 *   width?: number, filter?: "nearest" | "bilinear" | "bicubic",
 *   outside?: "transparent" | "edge" | "reflect" | `#${string}` | { value: number },
 * }} OutputOptions
 */
/**
 * In the names of `POST /report`.
 *
 * @typedef {{
 *   folds: number, mirrored: boolean, residual: number, exceeded: number,
 *   warnings: { code: string, [figure: string]: unknown }[],
 * }} Report
 */
/** @typedef {import("./instance.js").Instance} Instance */

/** An image in the memory of the engine. */
export class SourceImage extends Held {
  /** @type {PredefinedColorSpace | undefined} */
  #space;

  /**
   * @internal
   * @param {Instance} instance
   * @param {number} number
   * @param {PredefinedColorSpace} [space]
   */
  constructor(instance, number, space) {
    super(instance, number);
    this.#space = space;
  }

  /**
   * @internal
   * @param {Instance} instance
   * @param {Pixels} pixels
   */
  static of(instance, { width, height, data, colorSpace }) {
    if (!(data instanceof Uint8ClampedArray || data instanceof Uint8Array))
      throw new TypeError("the pixels of an image are RGBA of 8 bits, in a Uint8ClampedArray");
    const number = instance.make("image", instance.put(data), width, height);
    return new SourceImage(instance, number, colorSpace);
  }

  /** The colour space of its pixels, which those that are drawn of it have too. */
  get colorSpace() {
    return this.#space;
  }
}

/**
 * @param {{ width: number, height: number, bytes: Uint8Array<ArrayBuffer> }} drawn
 * @param {PredefinedColorSpace | undefined} colorSpace
 * @returns {DrawnPixels}
 */
export function pixelsOf({ width, height, bytes }, colorSpace) {
  const space = colorSpace && { colorSpace };
  const data = new Uint8ClampedArray(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (typeof ImageData === "undefined") return { width, height, data, ...space };
  return new ImageData(bytes.byteOffset ? data.slice() : data, width, height, space);
}

/** Handles that were moved. */
export class Pose extends Held {
  /** @type {Report} */
  #report;

  /**
   * @internal
   * @param {Instance} instance
   * @param {number} number
   */
  constructor(instance, number) {
    super(instance, number);
    this.#report = instance.json(instance.make("report", number));
  }

  /** Folds, the residual and warnings. */
  get report() {
    return this.#report;
  }

  /** Cells that fold over others. */
  get folds() {
    return this.#report.folds;
  }

  /** The largest distance between a moved handle and where it is drawn, px. */
  get residual() {
    return this.#report.residual;
  }

  /**
   * Draws an image of the plan's size. What nothing covers is transparent.
   *
   * @param {Pixels | SourceImage} image
   * @param {OutputOptions} [output]
   * @returns {DrawnPixels}
   */
  warp(image, output = {}) {
    const [instance] = inUse(this);
    if (image instanceof SourceImage) return this.#draw(image, output);
    const source = SourceImage.of(instance, image);
    try {
      return this.#draw(source, output);
    } finally {
      source.dispose();
    }
  }

  /**
   * @param {SourceImage} source
   * @param {OutputOptions} output
   */
  #draw(source, output) {
    const { width, height, bytes } = this.#drawn(numberIn(inUse(this)[0], source), output);
    return pixelsOf({ width, height, bytes }, source.colorSpace);
  }

  /**
   * @param {number} subject
   * @param {OutputOptions} output
   */
  #drawn(subject, output) {
    const [instance, pose] = inUse(this);
    const number = instance.make("draw", pose, subject, instance.putJson({ output }));
    const [width, height, samples] = instance.head(number, 3);
    instance.free(number);
    return { width, height, bytes: instance.take(samples) };
  }

  /**
   * Draws labels, which are never mixed; 0 where nothing is.
   *
   * @template {Labels} T
   * @param {T} labels
   * @param {OutputOptions} [output]
   * @returns {{ width: number, height: number, data: T["data"] }}
   */
  labels(labels, output = {}) {
    const [instance] = inUse(this);
    const { data } = labels;
    const kind = [Uint8Array, Uint8ClampedArray, Uint16Array, Uint32Array].find(
      (kind) => data instanceof kind,
    );
    if (!kind) throw new TypeError("labels are in a Uint8Array, Uint16Array or Uint32Array");
    const bits = 8 * kind.BYTES_PER_ELEMENT;
    const number = instance.make("labels", instance.put(data), labels.width, labels.height, bits);
    try {
      const { width, height, bytes } = this.#drawn(number, output);
      const posed = /** @type {T["data"]} */ (new kind(bytes.buffer));
      return { width, height, data: posed };
    } finally {
      instance.free(number);
    }
  }

  /**
   * How much of each pixel the image covers, 0 to 255.
   *
   * @param {OutputOptions} [output]
   * @returns {{ width: number, height: number, data: Uint8Array<ArrayBuffer> }}
   */
  coverage(output = {}) {
    const { width, height, bytes } = this.#drawn(0, output);
    return { width, height, data: bytes };
  }

  /**
   * Where positions go, by the exact function; or, inversely, which positions go there.
   *
   * @param {Float64Array | [number, number][]} xy px, x then y
   * @param {{ inverse?: boolean }} [options]
   * @returns {Float64Array<ArrayBuffer>} as many; NaN where nothing maps
   */
  points(xy, { inverse = false } = {}) {
    const [instance, pose] = inUse(this);
    const given = xy instanceof Float64Array ? xy : new Float64Array(xy.flat());
    const mapped = instance.make("points", pose, instance.put(given), Number(inverse));
    return new Float64Array(instance.take(mapped).buffer);
  }

  /**
   * A position for each pixel of the image, px, row by row; NaN where nothing is. `inverse`: the
   * position of the source that the pixel shows; `forward`: where its centre goes.
   *
   * @param {{ direction?: "inverse" | "forward" }} [options]
   * @returns {Float32Array<ArrayBuffer>}
   */
  map({ direction = "inverse" } = {}) {
    const [instance, pose] = inUse(this);
    const map = instance.make("map", pose, Number(direction === "forward"));
    return new Float32Array(instance.take(map).buffer);
  }

  /**
   * The posed vertices of the grid, row by row, px. The order of drawing (`depth`) is not in it.
   *
   * @returns {{ columns: number, rows: number, xy: Float32Array<ArrayBuffer> }}
   */
  mesh() {
    const [instance, pose] = inUse(this);
    const number = instance.make("mesh", pose);
    const [columns, rows] = instance.head(number, 2);
    return { columns, rows, xy: new Float32Array(instance.take(number, 8).buffer) };
  }
}
