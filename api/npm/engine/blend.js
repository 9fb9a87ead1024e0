// Averages, morphs, caricatures and symmetric faces: one sum over several images.

import { Held, inUse, numberIn } from "./instance.js";
import { SourceImage, pixelsOf } from "./pose.js";

/** @typedef {import("./plan.js").Handle} Handle */
/** @typedef {import("./pose.js").Pixels} Pixels */
/** @typedef {import("./pose.js").DrawnPixels} DrawnPixels */
/**
 * The object of `POST /blend`, where `image` is an index into the images and every entry has its
 * landmarks; api/openapi.json describes the fields.
 *
 * @typedef {{
 *   image: number, p: Handle[], names?: string[], shape?: number | number[],
 *   colour?: number | number[], mirror?: boolean, pairs?: number[],
 * }} BlendEntry
 */
/** @typedef {{ images: BlendEntry[], steps?: number, [field: string]: unknown }} BlendObject */
/**
 * One result. `landmarks`: where they are in it, px of the reference frame; `clamped`: samples that
 * were cut off below 0 or above 255; `folds`: drawn cells that fold, for each entry.
 *
 * @typedef {{ image: DrawnPixels, landmarks: Handle[], clamped: number, folds: number[] }} Blended
 */

const text = new TextDecoder();

/** Images and their landmarks, ready to be added. */
export class Blend extends Held {
  #frames;
  /** @type {PredefinedColorSpace | undefined} */
  #space;

  /**
   * @param {import("./instance.js").Instance} instance
   * @param {(Pixels | SourceImage)[]} images
   * @param {BlendObject} object
   */
  constructor(instance, images, object) {
    /** @type {SourceImage[]} */
    const copies = [];
    /** @type {(image: Pixels | SourceImage) => SourceImage} */
    const held = (image) => {
      if (image instanceof SourceImage) return image;
      copies.push(SourceImage.of(instance, image));
      return copies[copies.length - 1];
    };
    try {
      const numbers = new Uint32Array(images.map((image) => numberIn(instance, held(image))));
      super(instance, instance.make("blend", instance.put(numbers), instance.putJson(object)));
    } finally {
      // The blend holds what it needs of them.
      copies.forEach((copy) => copy.dispose());
    }
    this.#space = images[0].colorSpace;
    this.#frames = instance.count("frames", inUse(this)[1]);
  }

  /** The number of results. */
  get frames() {
    return this.#frames;
  }

  /**
   * @param {number} index from 0
   * @returns {Blended}
   */
  frame(index) {
    const [instance, number] = inUse(this);
    const bytes = instance.take(instance.make("frame", number, index));
    const head = new DataView(bytes.buffer);
    const [width, height, length] = [0, 4, 8].map((at) => head.getUint32(at, true));
    const report = JSON.parse(text.decode(bytes.subarray(12, 12 + length)));
    const pixels = { width, height, bytes: bytes.subarray(12 + length) };
    return { image: pixelsOf(pixels, this.#space), ...report };
  }
}

/**
 * The results of a blend, each made when it is taken. A generator that is never asked holds nothing.
 *
 * @param {import("./instance.js").Instance} instance
 * @param {(Pixels | SourceImage)[]} images
 * @param {BlendObject} object
 * @returns {Generator<Blended, void>}
 */
export function* framesOf(instance, images, object) {
  const blend = new Blend(instance, images, object);
  try {
    for (let index = 0; index < blend.frames; index++) yield blend.frame(index);
  } finally {
    blend.dispose();
  }
}
