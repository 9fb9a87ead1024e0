// The engine with the WebAssembly file in the module: for widgets, single files, and wherever a
// second file is in the way. It is a third larger, and compiled when it is first loaded.

import { Engine as FileEngine } from "./index.js";
import packed from "./inline-wasm.js";
import { unpacked } from "./unpack.js";

export * from "./index.js";

/** @type {Promise<WebAssembly.Module> | undefined} */
let module;

/** As that of `mlswarp/engine`; nothing is fetched. */
export class Engine extends FileEngine {
  /**
   * @override
   * @param {import("./index.js").Source | Promise<WebAssembly.Module>} [source]
   * @returns {Promise<Engine>}
   */
  static async load(source = (module ??= unpacked(packed))) {
    return super.load(await source);
  }
}
