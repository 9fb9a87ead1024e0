// The warp without a server: the engine of the package, as WebAssembly in a worker.

import { boxFrom, boxOf, canvasOf } from "../canvas.js";
import { isOutlined, restOf, wire } from "../edits.js";
import { Mesh } from "../mesh.js";
import { Follower } from "./follower.js";

/** Up to this many pixels the engine draws the picture at rest too; more would keep it busy. */
const MOST_PIXELS = 4e6;

/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerEngine} WorkerEngine */
/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerPlan} WorkerPlan */
/** @typedef {import("../../../api/npm/engine/index.js").Handle} Handle */
/** @typedef {import("../../../api/npm/engine/index.js").WarpObject} WarpObject */

export class Local extends Follower {
  /** @type {Promise<WorkerEngine> | null} */
  #engine = null;
  /** @type {WorkerPlan | null} */
  #plan = null;
  /** @type {Promise<import("../../../api/npm/engine/worker-engine.js").WorkerOutline> | null} */
  #outline = null;
  #words = "";
  /** @type {Page.MeshGrid | null} */
  #grid = null;
  /** The newest pose that waits for the one before. @type {[Page.Document, number] | null} */
  #next = null;
  #posing = Promise.resolve();
  #isPosing = false;
  /** That of the newest file. @type {Page.Box | null} */
  #box = null;
  #file;

  /**
   * @param {Blob} blob
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {import("./follower.js").Told} told
   */
  constructor(blob, store, view, told) {
    super(store, view, told);
    this.#file = blob.arrayBuffer().then((bytes) => new Uint8Array(bytes));
    this.follow();
  }

  release() {
    super.release();
    this.#engine?.then((engine) => engine.dispose()).catch(() => {});
  }

  /** @param {string} words */
  has(words) {
    return this.#words === words;
  }

  /**
   * @param {unknown} error
   * @param {number} revision
   */
  failed(error, revision) {
    // Another engine starts without a plan.
    if (/** @type {Error} */ (error).name === "EngineCrashed") {
      this.#engine = this.#plan = this.#outline = null;
      this.#words = "";
    }
    super.failed(error, revision);
  }

  /** The engine, which only who has no server loads. */
  #load() {
    return (this.#engine ??= import("../../../api/npm/engine/worker-engine.js").then(
      ({ WorkerEngine }) => WorkerEngine.spawn(),
    ));
  }

  /**
   * @param {Page.Rest} rest
   * @param {string} words
   */
  async take({ p, output: _, ...rest }, words) {
    const engine = await this.#load();
    const size = /** @type {Page.Size} */ (this.view.size);
    const isCut = isOutlined(rest);
    if (isCut) this.#outline ??= engine.outline(await this.#file);
    const outline = isCut && (await this.#outline);
    const options =
      /** @type {import("../../../api/npm/engine/worker-engine.js").WorkerPlanOptions} */ ({
        size,
        ...rest,
        ...(outline && { outline }),
      });
    const plan = await engine.plan(/** @type {Handle[]} */ (p), options);
    const pose = await plan.pose(/** @type {Handle[]} */ (p));
    const { columns, rows, xy } = await pose.mesh();
    pose.dispose();
    this.#plan?.dispose();
    this.#plan = plan;
    const [width, height] = size;
    // The lines are at equal distances, but for the last one.
    this.#grid = { columns, rows, width, height, cell: [xy[2], xy[2 * columns + 1]] };
    this.view.isCut = isCut;
    this.#words = words;
  }

  /**
   * @param {Page.Document} document
   * @param {number} revision
   */
  preview(document, revision) {
    this.#next = [document, revision];
    if (!this.#isPosing) this.#posing = this.#pose();
  }

  async #pose() {
    this.#isPosing = true;
    while (this.#next && this.#plan && !this.signal.aborted) {
      const [[document, revision], grid, plan] = [this.#next, this.#grid, this.#plan];
      this.#next = null;
      try {
        const pose = await plan.pose(/** @type {Handle[]} */ (wire(document, "q")));
        const { xy } = await pose.mesh();
        pose.dispose();
        if (!grid || grid !== this.#grid || revision <= this.settled) continue;
        this.residual = pose.report.residual;
        this.mesh = new Mesh(grid, xy);
        if (this.view.webgl !== "none") this.show(this.mesh, revision);
      } catch (error) {
        if (!this.signal.aborted) this.failed(error, revision);
      }
    }
    this.#isPosing = false;
  }

  /**
   * @param {Page.Document} document
   * @returns {Promise<import("./follower.js").Drawn>}
   */
  async draw(document) {
    const size = /** @type {Page.Size} */ (this.view.size);
    await this.#posing;
    const isLarge = size[0] * size[1] > MOST_PIXELS && this.view.webgl !== "none";
    const blob = isLarge ? null : await this.fileOf(document, {});
    const box = blob ? this.#box : boxOf(canvasOf(document), size, this.mesh);
    return { blob, box, mesh: null, residual: this.residual };
  }

  /**
   * @param {Page.Document} document
   * @param {import("./follower.js").FileOptions} output
   */
  async fileOf(document, output) {
    const rest = restOf(document);
    const warp = { ...rest, q: wire(document, "q"), output: { ...rest.output, ...output } };
    const engine = await this.#load();
    const { file, report } = await engine.warpFileWithReport(
      await this.#file,
      /** @type {WarpObject} */ (warp),
    );
    this.#box = boxFrom(report.canvas);
    return new Blob([file], { type: `image/${output.format ?? "png"}` });
  }
}
