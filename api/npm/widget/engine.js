// The engine of the widget. A widget is loaded from a blob, beside which there is nothing: so the
// script of the worker and the WebAssembly file are in its module.

import { unpacked } from "../engine/unpack.js";
import { WorkerEngine as FileEngine } from "../engine/worker-engine.js";
import script from "bundled:../engine/worker.js";

/** Of all widgets of this module. @type {{ wasm: WebAssembly.Module, worker: string } | undefined} */
let parts;

export class WorkerEngine extends FileEngine {
  /** @override */
  static async spawn() {
    const worker = new Blob([script], { type: "text/javascript" });
    parts ??= { wasm: await unpacked(MLSWARP_WASM), worker: URL.createObjectURL(worker) };
    return super.spawn(parts);
  }
}
