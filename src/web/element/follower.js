// Follows the document of the stage: hands its rest handles to what warps, shows a preview of each
// pose, and the exact picture when the pointer rests. `Remote` warps by a server, `Local` here.

import { restOf, wire } from "../edits.js";

/** Time without movement, ms, after which the pointer counts as resting. */
const REST = 150;
/** Pauses before a failed step is repeated, ms. */
const [FIRST, LONGEST] = [500, 10_000];

/** @typedef {"loading" | "busy" | "ready" | "error"} Condition */
/** @typedef {{ format?: string, width?: number, quality?: number }} FileOptions */
/** @typedef {{ problem: (error: unknown) => void, shown: () => void }} Told */
/**
 * The exact picture of a pose; `mesh` if there was no preview of it. Without a file the preview is
 * the picture.
 *
 * @typedef {{
 *   blob: Blob | null,
 *   box: Page.Box | null,
 *   mesh: Page.Mesh | null,
 *   residual: number | null,
 * }} Drawn
 */

export class Follower {
  /** @type {Page.Mesh | null} */
  mesh = null;
  /** @type {Condition} */
  condition = "loading";
  /** Of the shown picture; null: not known. @type {number | null} */
  residual = null;
  /** The revision of the last preview, and the newest that is exact or refused. */
  live = -1;
  settled = -1;

  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #timer = undefined;
  #running = false;
  #again = false;
  #failures = 0;
  #changed = 0;
  #end = new AbortController();
  /** @type {(() => void)[]} */
  #waiting = [];

  /**
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Told} told
   */
  constructor(store, view, told) {
    this.store = store;
    this.view = view;
    this.told = told;
    const leave = store.subscribe(
      ({ revision }, { revision: before }) => revision !== before && this.follow(),
    );
    this.signal.addEventListener("abort", leave);
  }

  get signal() {
    return this.#end.signal;
  }

  /** Nothing is asked or shown any more. */
  release() {
    this.#end.abort(new DOMException("the element has left", "AbortError"));
    clearTimeout(this.#timer);
    for (const tell of this.#waiting) tell();
  }

  // What a follower does

  /**
   * Whether it has these rest handles and settings.
   *
   * @param {string} _words their JSON
   */
  has(_words) {
    return false;
  }

  /**
   * Takes them.
   *
   * @param {Page.Rest} _rest
   * @param {string} _words
   * @returns {Promise<void>}
   */
  async take(_rest, _words) {}

  /**
   * Shows a preview of a pose of the handles that it has, now or soon.
   *
   * @param {Page.Document} _document
   * @param {number} _revision
   */
  preview(_document, _revision) {}

  /**
   * @param {Page.Document} _document
   * @returns {Promise<Drawn>}
   */
  async draw(_document) {
    return { blob: null, box: null, mesh: null, residual: null };
  }

  /**
   * @param {Page.Document} _document
   * @param {FileOptions} _output
   * @returns {Promise<Blob>}
   */
  async fileOf(_document, _output) {
    return new Blob();
  }

  /**
   * Whether it may help to try again.
   *
   * @param {unknown} _error
   */
  isPassing(_error) {
    return false;
  }

  // The loop

  /** The document has changed. */
  follow() {
    if (this.signal.aborted) return;
    this.#changed = performance.now();
    if (this.condition !== "loading") this.condition = "busy";
    this.pose();
    this.#run();
  }

  /** Shows a preview, if the rest handles are there. */
  pose() {
    const { document, revision } = this.store.state;
    if (revision !== this.settled && this.has(JSON.stringify(restOf(document))))
      this.preview(document, revision);
  }

  /**
   * Shows a posed grid.
   *
   * @param {Page.Mesh} mesh
   * @param {number} revision
   * @param {() => void} [done]
   */
  show(mesh, revision, done = () => {}) {
    this.live = revision;
    this.mesh = mesh;
    this.view.showMesh(mesh, done);
  }

  /** One loop decides the next step, so that nothing outdated is shown. */
  async #run() {
    this.#again = true;
    if (this.#running) return;
    this.#running = true;
    clearTimeout(this.#timer);
    while (this.#again && !this.signal.aborted) {
      this.#again = false;
      const { revision } = this.store.state;
      try {
        if (await this.#step()) this.#again = true;
        this.#failures = 0;
      } catch (error) {
        if (!this.signal.aborted) this.failed(error, revision);
      }
    }
    this.#running = false;
    for (const tell of this.#waiting.splice(0)) tell();
  }

  /**
   * @param {unknown} error
   * @param {number} revision
   */
  failed(error, revision) {
    this.condition = "error";
    if (this.isPassing(error)) {
      if (!this.#failures) this.told.problem(error);
      const pause = Math.min(LONGEST, FIRST * 2 ** this.#failures++);
      this.#timer = setTimeout(() => this.#run(), pause);
    } else {
      this.settled = revision;
      this.told.problem(error);
    }
  }

  /** Whether another step may follow at once. */
  async #step() {
    const { document, revision, before } = this.store.state;
    const rest = restOf(document);
    const words = JSON.stringify(rest);
    if (!this.has(words)) {
      await this.take(rest, words);
      this.pose();
      return true;
    }
    if (revision === this.settled) return false;
    const left = this.#changed + REST - performance.now();
    if (before || left > 0) {
      // The end of a drag is no change of the document.
      this.#timer = setTimeout(() => this.#run(), before ? REST : left);
      return false;
    }
    const { blob, box, mesh, residual } = await this.draw(document);
    /** @type {() => boolean} */
    const isOld = () => revision !== this.store.state.revision;
    if (isOld() || (blob && !(await this.view.showPng(blob, box, this.signal))) || isOld())
      return true;
    if (mesh) {
      this.mesh = mesh;
      this.view.setMesh(mesh);
    }
    this.residual = residual;
    this.settled = revision;
    this.condition = "ready";
    this.told.shown();
    return false;
  }

  /**
   * The file of the shown pose.
   *
   * @param {FileOptions} output
   * @returns {Promise<Blob>}
   */
  async file(output) {
    while (this.#running) await new Promise((resolve) => this.#waiting.push(() => resolve(null)));
    this.signal.throwIfAborted();
    const { document } = this.store.state;
    if (!this.has(JSON.stringify(restOf(document))))
      throw new DOMException("nothing has the picture yet", "InvalidStateError");
    return this.fileOf(document, output);
  }
}

/**
 * @param {{ x: number, y: number, width: number, height: number } | null | undefined} canvas
 * @returns {Page.Box | null}
 */
export const arrayOfBox = (canvas) =>
  canvas ? [canvas.x, canvas.y, canvas.width, canvas.height] : null;

/** @type {(document: Page.Document) => [p: Page.WireHandle[], q: Page.WireHandle[]]} */
export const sides = (document) => [wire(document, "p"), wire(document, "q")];
