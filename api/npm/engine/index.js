/// <reference lib="esnext.disposable" preserve="true" />

// The engine of mlswarp in the browser and in Node: plans, poses, pixels, points and files, without
// a server. Everything but loading is synchronous.

import { Blend, framesOf } from "./blend.js";
import { EngineCrashed, MlswarpError } from "./errors.js";
import { Instance, numberIn } from "./instance.js";
import { moduleOf } from "./module.js";
import { Outline, Plan } from "./plan.js";
import { SourceImage, Pose } from "./pose.js";

export { EngineCrashed, MlswarpError, Outline, Plan, Pose, SourceImage };
export {
  WorkerEngine,
  WorkerImage,
  WorkerOutline,
  WorkerPlan,
  WorkerPose,
} from "./worker-engine.js";

/** @typedef {import("./module.js").Source} Source */
/** @typedef {import("./instance.js").Bytes} Bytes */
/** @typedef {import("./plan.js").Handle} Handle */
/** @typedef {import("./plan.js").PlanOptions} PlanOptions */
/** @typedef {import("./plan.js").WarpObject} WarpObject */
/** @typedef {import("./pose.js").Pixels} Pixels */
/** @typedef {import("./pose.js").Labels} Labels */
/** @typedef {import("./pose.js").OutputOptions} OutputOptions */
/** @typedef {import("./pose.js").Report} Report */
/** @typedef {import("./blend.js").BlendObject} BlendObject */
/** @typedef {import("./blend.js").Blended} Blended */
/** @typedef {{ region?: Bytes, frame?: "gif" }} FileOptions */
/**
 * `canvas`: the part of the posed plane that the file shows, as in the header `Warp-Canvas`; absent
 * if that is the box of the source.
 *
 * @typedef {Report & { canvas?: string }} FileReport
 */
/**
 * @typedef {{
 *   p: Handle[], q?: Handle[], names?: string[], units: "px" | "normalized", format: string,
 *   unmatched?: { p: string[], q: string[] },
 * }} Landmarks
 */

/** The engine: a memory of its own, in which plans, poses and images live. */
export class Engine {
  /** @type {Instance} */
  #instance;

  /** @param {Instance} instance */
  constructor(instance) {
    this.#instance = instance;
  }

  /**
   * An engine. Call it as often as you like: the file is fetched and compiled once, and each engine
   * has a memory of its own. `source`: another place of `mlswarp.wasm`, its bytes, or what was
   * compiled of it; by default, the file of this package.
   *
   * @param {Source} [source]
   * @returns {Promise<Engine>}
   */
  static async load(source) {
    return new this(new Instance(await moduleOf(source)));
  }

  /**
   * Handles at rest, with everything computed that does not depend on a pose.
   *
   * @param {Handle[]} p points, lines of two positions, and polylines; px, x then y
   * @param {PlanOptions} options the size of the image, and the method with its parameters
   * @returns {Plan}
   */
  plan(p, { size, outline, ...rest }) {
    const [instance, [width, height]] = [this.#instance, size];
    if (!Number.isSafeInteger(width) || !Number.isSafeInteger(height))
      throw new TypeError("`size` is the width and height of the image: whole numbers of pixels");
    const within = outline ? numberIn(instance, outline) : 0;
    const warp = instance.putJson({ ...rest, p });
    return new Plan(instance, instance.make("plan", warp, width, height, within), p.length);
  }

  /**
   * What is visible of an image, for plans that follow it. `region`: a mask; only what is white in
   * it counts.
   *
   * @param {Bytes | SourceImage} image a file, or an image of this engine
   * @param {{ region?: Bytes | SourceImage }} [options]
   * @returns {Outline}
   */
  outline(image, { region } = {}) {
    const instance = this.#instance;
    const [number, mask] = [image, region].map((from) =>
      from instanceof SourceImage ? numberIn(instance, from) : from ? instance.put(from) : 0,
    );
    return new Outline(instance, instance.make("outline", number, mask));
  }

  /**
   * An image that many poses draw: its pixels are copied once.
   *
   * @param {Pixels} pixels RGBA, not premultiplied
   * @returns {SourceImage}
   */
  image(pixels) {
    return SourceImage.of(this.#instance, pixels);
  }

  /**
   * The file that the service sends for this file and this warp object (`POST /warp`): the same
   * bytes. `region`: a mask as a file; only what is white in it moves. `frame`: a GIF, as a frame
   * of an animation.
   *
   * @param {Bytes} file PNG, JPEG, WebP, TIFF, GIF or BMP
   * @param {WarpObject} warp
   * @param {FileOptions} [options]
   * @returns {Uint8Array<ArrayBuffer>}
   */
  warpFile(file, warp, options) {
    return this.warpFileWithReport(file, warp, options).file;
  }

  /**
   * As `warpFile`, with what the service says in headers.
   *
   * @param {Bytes} file
   * @param {WarpObject} warp
   * @param {FileOptions} [options]
   * @returns {{ file: Uint8Array<ArrayBuffer>, report: FileReport }}
   */
  warpFileWithReport(file, warp, { region, frame } = {}) {
    const instance = this.#instance;
    const drawn = instance.take(
      instance.make(
        "warp_file",
        instance.put(file),
        instance.putJson(warp),
        region ? instance.put(region) : 0,
        Number(frame === "gif"),
      ),
    );
    const length = new DataView(drawn.buffer).getUint32(0, true);
    const report = JSON.parse(new TextDecoder().decode(drawn.subarray(4, 4 + length)));
    return { file: drawn.slice(4 + length), report };
  }

  /**
   * The handles of landmark files, as the fields of a warp object. `p`: a file with both sides, or
   * with `q` that of the rest positions.
   *
   * @param {Bytes} p
   * @param {Bytes} [q]
   * @param {{ match?: "name" | "order", item?: string | number }} [options]
   * @returns {Landmarks}
   */
  landmarks(p, q, options = {}) {
    const instance = this.#instance;
    const [files, choice] = [[p, q].map((file) => (file ? instance.put(file) : 0)), options];
    return instance.json(instance.make("landmarks", instance.putJson(choice), ...files));
  }

  /**
   * Brings the landmarks of all images to one shape, and adds the images, as `POST /blend`: an
   * average, a step of a morph, a caricature (shares beyond 1), a symmetric face (`mirror`). The
   * mean of two: `blend([a, b], { images: [{ image: 0, p }, { image: 1, p: q }] })`.
   *
   * @param {(Pixels | SourceImage)[]} images RGBA
   * @param {BlendObject} blend of one result
   * @returns {Blended}
   */
  blend(images, blend) {
    const ready = new Blend(this.#instance, images, blend);
    try {
      if (ready.frames === 1) return ready.frame(0);
    } finally {
      ready.dispose();
    }
    throw new TypeError(`the blend has ${ready.frames} results: use blendFrames`);
  }

  /**
   * The results of a blend one after another: `steps` from the first image to the second, or one for
   * each share in lists. Coefficients are computed once for all of them.
   *
   * @param {(Pixels | SourceImage)[]} images
   * @param {BlendObject} blend
   * @returns {Generator<Blended, void>}
   */
  blendFrames(images, blend) {
    return framesOf(this.#instance, images, blend);
  }

  /** Bytes of its memory. It grows when it must, and never shrinks before `dispose`. */
  get memoryBytes() {
    return this.#instance.memoryBytes;
  }

  /** Plans, poses and images that have not been disposed of. */
  get objects() {
    return this.#instance.objects;
  }

  /** Ends it and everything that was made with it. */
  dispose() {
    this.#instance.end();
  }

  [Symbol.dispose]() {
    this.dispose();
  }

  /** @internal @param {Engine} engine */
  static panicForTests(engine) {
    engine.#instance.panic();
  }
}
