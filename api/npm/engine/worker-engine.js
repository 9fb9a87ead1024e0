/// <reference lib="esnext.disposable" preserve="true" />

// An engine in a worker of the browser: the same methods, which return promises, so that the page
// never waits.

import { EngineCrashed, MlswarpError } from "./errors.js";

/** @typedef {import("./index.js").Handle} Handle */
/** @typedef {import("./index.js").OutputOptions} OutputOptions */
/** @typedef {{ id: number, on: number, method: string, given: any[] }} Call */
/**
 * @typedef {{
 *   id: number, result?: any, problem?: Record<string, unknown>, text?: string, isCrash?: boolean,
 *   stack?: string,
 * }} Answer
 */
/** @typedef {{ signal?: AbortSignal }} Abortable */
/**
 * @typedef {Omit<import("./index.js").PlanOptions, "outline"> & { outline?: WorkerOutline }} WorkerPlanOptions
 */
/** @typedef {{ call: Call, resolve(result: any): void, reject(error: unknown): void }} Waiting */

/** The calls to a worker, one under way at a time, so that those that wait can be withdrawn. */
class Calls {
  #worker;
  /** @type {Waiting[]} */
  #waiting = [];
  /** @type {Waiting | null} */
  #current = null;
  #last = 0;
  #ended = "";
  forgotten = new FinalizationRegistry((/** @type {number} */ number) => this.free(number));

  /** @param {Worker} worker */
  constructor(worker) {
    this.#worker = worker;
    worker.onmessage = ({ data }) => this.#answered(data);
    worker.onerror = (event) => this.end(`the worker has ended: ${event.message ?? "not loaded"}`);
  }

  /**
   * @param {number} on the number of the object, 0 for the engine
   * @param {string} method
   * @param {unknown[]} given
   * @param {AbortSignal} [signal]
   * @returns {Promise<any>}
   */
  call(on, method, given, signal) {
    return new Promise((resolve, reject) => {
      signal?.throwIfAborted();
      if (this.#ended) throw new EngineCrashed(this.#ended);
      const call = { id: ++this.#last, on, method, given };
      /** @type {Waiting} */
      const waiting = { call, resolve, reject };
      signal?.addEventListener(
        "abort",
        () => {
          // What is under way is computed to its end, and its result is dropped.
          this.#waiting = this.#waiting.filter((other) => other !== waiting);
          reject(signal.reason);
        },
        { once: true },
      );
      this.#waiting.push(waiting);
      this.#next();
    });
  }

  #next() {
    if (this.#current) return;
    this.#current = this.#waiting.shift() ?? null;
    try {
      if (this.#current) this.#worker.postMessage(this.#current.call);
    } catch (error) {
      // What cannot be sent to a worker.
      this.#current?.reject(error);
      this.#current = null;
      this.#next();
    }
  }

  /** @param {Answer} answer */
  #answered({ result, problem, text = "", isCrash, stack }) {
    const current = this.#current;
    this.#current = null;
    if (problem) current?.reject(new MlswarpError(problem));
    else if (isCrash) current?.reject(new EngineCrashed(text, stack));
    else if (text) current?.reject(new TypeError(text));
    else current?.resolve(result);
    this.#next();
  }

  /** @param {number} number */
  free(number) {
    if (!this.#ended) this.call(number, "dispose", []).catch(() => {});
  }

  /** @param {string} why */
  end(why) {
    this.#ended ||= why;
    this.#worker.terminate();
    for (const { reject } of [this.#current, ...this.#waiting].filter((waiting) => !!waiting))
      reject(new EngineCrashed(this.#ended));
    [this.#current, this.#waiting] = [null, []];
  }
}

/** @type {(held: WorkerHeld, method: string, given: unknown[], signal?: AbortSignal) => Promise<any>} */
let callOn;
/** @type {(held: WorkerHeld) => { calls: Calls, number: number }} */
let partsOf;

/** What stands for an object in the worker. */
class WorkerHeld {
  /** @type {Calls} */
  #calls;
  #number;

  /**
   * @param {Calls} calls
   * @param {number} number
   */
  constructor(calls, number) {
    this.#calls = calls;
    this.#number = number;
    calls.forgotten.register(this, number, this);
  }

  static {
    callOn = (held, method, given, signal) => held.#calls.call(held.#number, method, given, signal);
    partsOf = (held) => ({ calls: held.#calls, number: held.#number });
  }

  /** Frees its memory now; otherwise that happens some time after it was forgotten. */
  dispose() {
    this.#calls.forgotten.unregister(this);
    this.#calls.free(this.#number);
  }

  [Symbol.dispose]() {
    this.dispose();
  }
}
/** An image in the memory of the worker's engine. */
export class WorkerImage extends WorkerHeld {}
/** As `Outline`. */
export class WorkerOutline extends WorkerHeld {}

/**
 * What is sent for an image or an outline: its number, if it is in the memory of this worker.
 *
 * @param {Calls} calls
 * @param {unknown} given
 */
function sentTo(calls, given) {
  if (!(given instanceof WorkerHeld)) return given;
  const { calls: own, number } = partsOf(given);
  if (own !== calls) throw new TypeError(`this ${given.constructor.name} is of another engine`);
  return { heldByWorker: number };
}

/** As `Plan`. */
export class WorkerPlan extends WorkerHeld {
  /**
   * @param {Handle[]} q
   * @param {number} [strength]
   * @param {Abortable} [options]
   * @returns {Promise<WorkerPose>}
   */
  async pose(q, strength = 1, { signal } = {}) {
    const { number, report } = await callOn(this, "pose", [q, strength], signal);
    return new WorkerPose(partsOf(this).calls, number, report);
  }
}

/** As `Pose`. */
export class WorkerPose extends WorkerHeld {
  /**
   * @param {Calls} calls
   * @param {number} number
   * @param {import("./index.js").Report} report
   */
  constructor(calls, number, report) {
    super(calls, number);
    /** Folds, the residual and warnings. */
    this.report = report;
  }

  /**
   * @param {import("./index.js").Pixels | WorkerImage} image
   * @param {OutputOptions} [output]
   * @param {Abortable} [options]
   * @returns {Promise<import("./pose.js").DrawnPixels>}
   */
  async warp(image, output = {}, { signal } = {}) {
    const given = sentTo(partsOf(this).calls, image);
    return callOn(this, "warp", [given, output], signal);
  }

  /**
   * @template {import("./index.js").Labels} T
   * @param {T} labels
   * @param {OutputOptions} [output]
   * @param {Abortable} [options]
   * @returns {Promise<{ width: number, height: number, data: T["data"] }>}
   */
  labels(labels, output = {}, { signal } = {}) {
    return callOn(this, "labels", [labels, output], signal);
  }

  /**
   * @param {OutputOptions} [output]
   * @param {Abortable} [options]
   * @returns {Promise<{ width: number, height: number, data: Uint8Array<ArrayBuffer> }>}
   */
  coverage(output = {}, { signal } = {}) {
    return callOn(this, "coverage", [output], signal);
  }

  /**
   * @param {Float64Array | [number, number][]} xy
   * @param {{ inverse?: boolean } & Abortable} [options]
   * @returns {Promise<Float64Array<ArrayBuffer>>}
   */
  points(xy, { inverse = false, signal } = {}) {
    return callOn(this, "points", [xy, { inverse }], signal);
  }

  /**
   * @param {{ direction?: "inverse" | "forward" } & Abortable} [options]
   * @returns {Promise<Float32Array<ArrayBuffer>>}
   */
  map({ direction = "inverse", signal } = {}) {
    return callOn(this, "map", [{ direction }], signal);
  }

  /**
   * @param {Abortable} [options]
   * @returns {Promise<{ columns: number, rows: number, xy: Float32Array<ArrayBuffer> }>}
   */
  mesh({ signal } = {}) {
    return callOn(this, "mesh", [], signal);
  }
}

/**
 * A worker that loads the engine. One from another origin may not be started; a script of this page
 * that imports it may.
 */
function started() {
  try {
    // Bundlers look for this expression as it stands.
    return new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  } catch (error) {
    if (!(error instanceof DOMException && error.name === "SecurityError")) throw error;
    const here = import.meta.url;
    return importing(new URL("worker.js", here).href);
  }
}

/** @param {string} place */
function importing(place) {
  const script = new Blob([`import ${JSON.stringify(place)};`], { type: "text/javascript" });
  const address = URL.createObjectURL(script);
  return new Worker(address, { type: "module" });
}

/** As `Engine`, in a worker of the browser. */
export class WorkerEngine {
  /** @type {Calls} */
  #calls;

  /** @param {Calls} calls */
  constructor(calls) {
    this.#calls = calls;
  }

  /**
   * Starts a worker. `wasm`: another place of `mlswarp.wasm`, or what was compiled of it; `worker`:
   * another place of `engine/worker.js`. `EngineCrashed` if it cannot be loaded.
   *
   * @param {{ wasm?: URL | string | WebAssembly.Module, worker?: URL | string }} [options]
   * @returns {Promise<WorkerEngine>}
   */
  static async spawn({ wasm, worker } = {}) {
    const calls = new Calls(worker ? importing(new URL(worker, location.href).href) : started());
    const isCompiled = wasm === undefined || wasm instanceof WebAssembly.Module;
    try {
      await calls.call(0, "load", [isCompiled ? wasm : new URL(wasm, location.href).href]);
    } catch (error) {
      calls.end("the engine is not loaded");
      throw error;
    }
    return new WorkerEngine(calls);
  }

  /**
   * @param {Handle[]} p
   * @param {WorkerPlanOptions} options
   * @param {Abortable} [options_]
   * @returns {Promise<WorkerPlan>}
   */
  async plan(p, { outline, ...options }, { signal } = {}) {
    const given = { ...options, outline: sentTo(this.#calls, outline) };
    const { number } = await this.#calls.call(0, "plan", [p, given], signal);
    return new WorkerPlan(this.#calls, number);
  }

  /**
   * @param {import("./index.js").Bytes | WorkerImage} image
   * @param {{ region?: import("./index.js").Bytes | WorkerImage } & Abortable} [options]
   * @returns {Promise<WorkerOutline>}
   */
  async outline(image, { region, signal } = {}) {
    const [whole, mask] = [image, region].map((from) => sentTo(this.#calls, from));
    const { number } = await this.#calls.call(0, "outline", [whole, { region: mask }], signal);
    return new WorkerOutline(this.#calls, number);
  }

  /**
   * @param {import("./index.js").Pixels} pixels
   * @param {Abortable} [options]
   * @returns {Promise<WorkerImage>}
   */
  async image(pixels, { signal } = {}) {
    const { number } = await this.#calls.call(0, "image", [pixels], signal);
    return new WorkerImage(this.#calls, number);
  }

  /**
   * @param {import("./index.js").Bytes} file
   * @param {import("./index.js").WarpObject} warp
   * @param {import("./index.js").FileOptions & Abortable} [options]
   * @returns {Promise<Uint8Array<ArrayBuffer>>}
   */
  warpFile(file, warp, { signal, ...options } = {}) {
    return this.#calls.call(0, "warpFile", [file, warp, options], signal);
  }

  /**
   * @param {import("./index.js").Bytes} file
   * @param {import("./index.js").WarpObject} warp
   * @param {import("./index.js").FileOptions & Abortable} [options]
   * @returns {Promise<{ file: Uint8Array<ArrayBuffer>, report: import("./index.js").FileReport }>}
   */
  warpFileWithReport(file, warp, { signal, ...options } = {}) {
    return this.#calls.call(0, "warpFileWithReport", [file, warp, options], signal);
  }

  /**
   * @param {import("./index.js").Bytes} p
   * @param {import("./index.js").Bytes} [q]
   * @param {{ match?: "name" | "order", item?: string | number } & Abortable} [options]
   * @returns {Promise<import("./index.js").Landmarks>}
   */
  landmarks(p, q, { signal, ...choice } = {}) {
    return this.#calls.call(0, "landmarks", [p, q, choice], signal);
  }

  /**
   * @param {(import("./index.js").Pixels | WorkerImage)[]} images
   * @param {import("./index.js").BlendObject} blend of one result
   * @param {Abortable} [options]
   * @returns {Promise<import("./index.js").Blended>}
   */
  async blend(images, blend, { signal } = {}) {
    const given = images.map((image) => sentTo(this.#calls, image));
    return this.#calls.call(0, "blend", [given, blend], signal);
  }

  /** Ends the worker, whatever it does. */
  dispose() {
    this.#calls.end("the engine has been disposed of");
  }

  [Symbol.dispose]() {
    this.dispose();
  }
}
