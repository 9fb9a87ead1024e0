/// <reference lib="esnext.disposable" preserve="true" />

// An instance of the WebAssembly file: the only module that knows its functions and its memory.

import { EngineCrashed, MlswarpError } from "./errors.js";
import { jsonOf } from "./json.js";

/** That of the file; see `wasm/src/lib.rs`. */
const ABI_VERSION = 3;

/**
 * @typedef {{
 *   memory: WebAssembly.Memory,
 *   abi_version(): number,
 *   panic_address(): number,
 *   panic_length(): number,
 *   panic_for_tests(): void,
 *   buffer(length: number): number,
 *   address(buffer: number): number,
 *   length(buffer: number): number,
 *   free(object: number): void,
 *   objects(): number,
 *   error(): number,
 *   plan(warp: number, width: number, height: number, outline: number): number,
 *   outline(image: number, region: number): number,
 *   pose(plan: number, pose: number): number,
 *   report(pose: number): number,
 *   image(pixels: number, width: number, height: number): number,
 *   labels(values: number, width: number, height: number, bits: number): number,
 *   draw(pose: number, subject: number, warp: number): number,
 *   blend(images: number, blend: number): number,
 *   frames(blend: number): number,
 *   frame(blend: number, index: number): number,
 *   points(pose: number, positions: number, isInverse: number): number,
 *   map(pose: number, isForward: number): number,
 *   mesh(pose: number): number,
 *   warp_file(file: number, warp: number, region: number, isGif: number): number,
 *   landmarks(options: number, p: number, q: number): number,
 * }} Exports
 */
/** @typedef {Exclude<keyof Exports, "memory">} Name */
/** @typedef {ArrayBufferView | ArrayBuffer} Bytes */

const utf8 = new TextEncoder();
const text = new TextDecoder();

/** @type {(bytes: Bytes) => Uint8Array} */
const view = (bytes) =>
  ArrayBuffer.isView(bytes)
    ? new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength)
    : new Uint8Array(bytes);

export class Instance {
  /** @type {Exports | null} */
  #exports;
  /** Lets go of what JavaScript has forgotten. */
  #forgotten = new FinalizationRegistry((/** @type {number} */ number) => this.free(number));
  /** @type {string} why it has ended */
  #ended = "";

  /** @param {WebAssembly.Module} module */
  constructor(module) {
    const { exports } = new WebAssembly.Instance(module, {});
    this.#exports = /** @type {Exports} */ (/** @type {unknown} */ (exports));
    const version = this.#exports.abi_version?.() >>> 0;
    if (version !== ABI_VERSION)
      throw new TypeError(
        `this WebAssembly file has version ${version} of the functions, and this package needs ${ABI_VERSION}: use the file of the package`,
      );
  }

  /** Bytes of its memory, which never shrinks. */
  get memoryBytes() {
    return this.#exports?.memory.buffer.byteLength ?? 0;
  }

  /** The number of objects that are held. */
  get objects() {
    return this.#call("objects");
  }

  /** Lets go of the memory. */
  end(why = "the engine has been disposed of") {
    this.#exports = null;
    this.#ended ||= why;
  }

  /**
   * @param {Name} name
   * @param {number[]} numbers
   * @returns {number}
   */
  #call(name, ...numbers) {
    const exports = this.#exports;
    if (!exports) throw new EngineCrashed(this.#ended);
    try {
      const function_ = /** @type {(...numbers: number[]) => number} */ (exports[name]);
      return function_(...numbers) >>> 0;
    } catch (cause) {
      // An argument that is no number has not been passed; a stack that is full is a RangeError.
      if (!(cause instanceof WebAssembly.RuntimeError || cause instanceof RangeError)) throw cause;
      // After a trap, nothing of the memory is what it should be; the text of a panic lies still.
      const at = exports.panic_address() >>> 0;
      const panic = text.decode(
        new Uint8Array(exports.memory.buffer, at, exports.panic_length() >>> 0),
      );
      this.end(panic || `the engine has ended: ${cause}`);
      throw new EngineCrashed(this.#ended, cause);
    }
  }

  /**
   * Calls a function that makes an object. Its buffers are taken by it.
   *
   * @param {Name} name
   * @param {number[]} numbers
   */
  make(name, ...numbers) {
    const made = this.#call(name, ...numbers);
    if (made !== 0) return made;
    const problem = this.#call("error");
    throw new MlswarpError(problem ? this.json(problem) : { code: "internal", detail: name });
  }

  /**
   * Calls a function that makes nothing.
   *
   * @param {"frames"} name
   * @param {number} number
   */
  count(name, number) {
    return this.#call(name, number);
  }

  /**
   * The number of a buffer with a copy of these bytes.
   *
   * @param {Bytes} bytes
   */
  put(bytes) {
    const from = view(bytes);
    const number = this.make("buffer", from.length);
    const at = this.#call("address", number);
    const { buffer } = /** @type {Exports} */ (this.#exports).memory;
    new Uint8Array(buffer, at, from.length).set(from);
    return number;
  }

  /** @param {unknown} value */
  putJson(value) {
    return this.put(utf8.encode(jsonOf(value)));
  }

  /** @param {number} number */
  #view(number) {
    const [at, length] = [this.#call("address", number), this.#call("length", number)];
    return new Uint8Array(/** @type {Exports} */ (this.#exports).memory.buffer, at, length);
  }

  /**
   * The numbers (u32) with which a buffer begins.
   *
   * @param {number} number
   * @param {number} count
   * @returns {number[]}
   */
  head(number, count) {
    const { buffer, byteOffset } = this.#view(number);
    const view = new DataView(buffer, byteOffset);
    return Array.from({ length: count }, (_, k) => view.getUint32(4 * k, true));
  }

  /**
   * A copy of a buffer from a byte on; the buffer is freed.
   *
   * @param {number} number
   * @param {number} [from]
   * @returns {Uint8Array<ArrayBuffer>}
   */
  take(number, from = 0) {
    // `slice` copies: a view would change under its holder, and detach when the memory grows.
    const bytes = /** @type {Uint8Array<ArrayBuffer>} */ (this.#view(number).slice(from));
    this.free(number);
    return bytes;
  }

  /** @param {number} number */
  json(number) {
    return JSON.parse(text.decode(this.take(number)));
  }

  /** @param {number} number */
  free(number) {
    if (this.#exports) this.#call("free", number);
  }

  /** For tests. */
  panic() {
    this.#call("panic_for_tests");
  }

  /**
   * Frees an object when its holder is forgotten.
   *
   * @param {object} holder
   * @param {number} number
   */
  watch(holder, number) {
    this.#forgotten.register(holder, number, holder);
  }

  /**
   * @param {object} holder
   * @param {number} number
   */
  release(holder, number) {
    this.#forgotten.unregister(holder);
    this.free(number);
  }
}

/**
 * The instance and the number of an object.
 *
 * @type {(held: Held) => [Instance, number]}
 */
export let inUse;

/**
 * The number of an object in this instance. Elsewhere that number means something else.
 *
 * @param {Instance} instance
 * @param {Held} held
 */
export function numberIn(instance, held) {
  const [own, number] = inUse(held);
  if (own !== instance) throw new TypeError(`this ${held.constructor.name} is of another engine`);
  return number;
}

/** What stands for an object of an instance until it is disposed of. */
export class Held {
  /** @type {Instance} */
  #instance;
  #number;
  #isHeld = true;

  /**
   * @param {Instance} instance
   * @param {number} number
   */
  constructor(instance, number) {
    this.#instance = instance;
    this.#number = number;
    instance.watch(this, number);
  }

  static {
    inUse = (held) => {
      if (!held.#isHeld) throw new TypeError(`this ${held.constructor.name} has been disposed of`);
      return [held.#instance, held.#number];
    };
  }

  /** Frees its memory now; otherwise that happens some time after it was forgotten. */
  dispose() {
    if (this.#isHeld) this.#instance.release(this, this.#number);
    this.#isHeld = false;
  }

  [Symbol.dispose]() {
    this.dispose();
  }
}
