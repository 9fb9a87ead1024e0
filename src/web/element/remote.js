// The warp by a server: a session with the picture, the coefficients that pose the preview here, a
// drag socket until they have arrived, and the server's own picture when the pointer rests.

import { ApiError } from "../../../api/npm/client/index.js";
import { restOf, wire } from "../edits.js";
import { Mesh } from "../mesh.js";
import { Plans } from "../plan.js";

/** @typedef {import("../../../api/npm/client/index.js").Client} Client */
/** @typedef {import("../../../api/npm/client/index.js").Session} Session */
/** @typedef {import("../../../api/npm/client/session.js").SessionObject} SessionObject */

/** @typedef {import("../../../api/npm/client/contract.js").WarpObject} Warp */

/** Time without movement, ms, after which the pointer counts as resting. */
const REST = 150;
/** Pauses before a failed step is repeated, ms. */
const [FIRST, LONGEST] = [500, 10_000];

/**
 * Whether it may help to ask again.
 *
 * @param {unknown} error
 */
const isPassing = (error) =>
  !(error instanceof ApiError) ||
  error.status === 408 ||
  error.status === 429 ||
  error.status > 500;

/** @typedef {"loading" | "busy" | "ready" | "error"} Condition */

export class Remote {
  /** @type {Page.Mesh | null} */
  mesh = null;
  /** @type {Condition} */
  condition = "loading";
  /** Of the shown picture; null: not known. @type {number | null} */
  residual = null;

  /** @type {Session | null} */
  #session = null;
  /** @type {Page.Session | null} */
  #known = null;
  #plans = new Plans(async (_, columns, rows, signal) => {
    const asked = { columns, rows, precision: /** @type {const} */ ("f16"), signal };
    return (await this.#session?.plan(asked).catch(() => null)) ?? null;
  });
  /** @type {import("../../../api/npm/client/index.js").Drag | null} */
  #drag = null;
  /** Numbers of the poses of the drag to revisions. @type {Map<number, number>} */
  #poses = new Map();
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #timer = undefined;
  #running = false;
  #again = false;
  #failures = 0;
  #changed = 0;
  /** Revisions: the newest whose picture is shown, or that the server has refused. */
  #settled = -1;
  #live = -1;
  #end = new AbortController();
  /** @type {(() => void)[]} */
  #waiting = [];

  /**
   * @param {Client} client
   * @param {string | undefined} id of the session, if the site has chosen it
   * @param {Blob} blob
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {{ problem: (error: unknown) => void, shown: () => void }} told
   * @param {Session | null} session one that exists, and whose handles are those of the document
   */
  constructor(client, id, blob, store, view, told, session) {
    this.client = client;
    this.id = id;
    this.blob = blob;
    this.store = store;
    this.view = view;
    this.told = told;
    const leave = store.subscribe(
      ({ revision }, { revision: before }) => revision !== before && this.follow(),
    );
    this.#end.signal.addEventListener("abort", leave);
    if (session?.object) {
      this.#session = session;
      this.#hear(session.object, JSON.stringify(restOf(store.state.document)));
    }
    this.follow();
  }

  /** Nothing is asked or shown any more; the session is deleted if it was opened here. */
  release() {
    this.#end.abort(new DOMException("the element has left", "AbortError"));
    clearTimeout(this.#timer);
    this.#plans.drop();
    this.#drag?.close();
    if (!this.id) this.#session?.delete({ keepalive: true }).catch(() => {});
    for (const tell of this.#waiting) tell();
  }

  /** The pose is never aligned here. @returns {Promise<null>} */
  async aligned() {
    return null;
  }

  /** The document has changed. */
  follow() {
    if (this.#end.signal.aborted) return;
    this.#changed = performance.now();
    if (this.condition !== "loading") this.condition = "busy";
    this.#pose();
    this.#run();
  }

  /** Poses the preview by the coefficients, or asks for it. */
  #pose() {
    const { document, revision } = this.store.state;
    const known = this.#known;
    if (!known || revision === this.#settled || JSON.stringify(restOf(document)) !== known.rest)
      return;
    const [p, q] = [wire(document, "p"), wire(document, "q")];
    const plan = this.view.webgl === "none" ? null : this.#plans.of(known);
    if (plan) {
      const mesh = plan.pose(p, q);
      this.#show(mesh, revision, () => {});
      this.residual = plan.residual(mesh, p, q);
    } else if (this.store.state.before) {
      this.#drag ??= this.#open();
      const number = this.#drag.pose(q);
      this.#poses.set(number, revision);
    }
  }

  /**
   * @param {Page.Mesh} mesh
   * @param {number} revision
   * @param {() => void} done
   */
  #show(mesh, revision, done) {
    this.#live = revision;
    this.mesh = mesh;
    this.view.showMesh(mesh, done);
  }

  #open() {
    const isPlain = this.view.webgl === "none";
    const wish = isPlain ? { frames: /** @type {const} */ ("png") } : { compact: true };
    const drag = /** @type {Session} */ (this.#session).drag({ ...wish, signal: this.#end.signal });
    drag.addEventListener("frame", (event) => {
      event.preventDefault();
      const { frame } =
        /** @type {Event & { frame: import("../../../api/npm/client/drag.js").Frame }} */ (event);
      const revision = this.#poses.get(frame.pose) ?? -1;
      for (const old of this.#poses.keys()) if (old < frame.pose) this.#poses.delete(old);
      if (revision <= Math.max(this.#live, this.#settled)) return frame.ack();
      if (frame.mesh) this.#show(new Mesh(frame.mesh, frame.mesh.xy), revision, () => frame.ack());
      else if (frame.blob) {
        const { x = 0, y = 0, width = 0, height = 0 } = frame.report?.canvas ?? {};
        const box = frame.report?.canvas ? /** @type {Page.Box} */ ([x, y, width, height]) : null;
        this.view.showFrame(frame.blob, box).then(() => frame.ack());
      }
    });
    drag.addEventListener("problem", (event) =>
      this.told.problem(/** @type {Event & { error: ApiError }} */ (event).error),
    );
    return drag;
  }

  /** One loop decides the next step, so that nothing outdated is shown. */
  async #run() {
    this.#again = true;
    if (this.#running) return;
    this.#running = true;
    clearTimeout(this.#timer);
    while (this.#again && !this.#end.signal.aborted) {
      this.#again = false;
      const { revision } = this.store.state;
      try {
        if (await this.#step()) this.#again = true;
        this.#failures = 0;
      } catch (error) {
        if (this.#end.signal.aborted) break;
        this.#failed(error, revision);
      }
    }
    this.#running = false;
    for (const tell of this.#waiting.splice(0)) tell();
  }

  /**
   * @param {unknown} error
   * @param {number} revision
   */
  #failed(error, revision) {
    this.condition = "error";
    if (isPassing(error)) {
      if (!this.#failures) this.told.problem(error);
      const pause = Math.min(LONGEST, FIRST * 2 ** this.#failures++);
      this.#timer = setTimeout(() => this.#run(), pause);
    } else {
      this.#settled = revision;
      this.told.problem(error);
    }
  }

  /** Whether another step may follow at once. */
  async #step() {
    const { document, revision, before } = this.store.state;
    const { signal } = this.#end;
    const rest = /** @type {Warp} */ (restOf(document));
    const words = JSON.stringify(rest);
    if (!this.#session) {
      const options = { id: this.id, reopen: true, signal };
      this.#session = await this.client.open(this.blob, rest, options);
    } else if (this.#known?.rest !== words) {
      await this.#session.putHandles(rest, { signal });
    } else {
      return this.#draw(revision, document, before !== null);
    }
    this.#hear(/** @type {SessionObject} */ (this.#session.object), words);
    return true;
  }

  /**
   * @param {SessionObject} object
   * @param {string} rest
   */
  #hear(object, rest) {
    const { width, height } = object.image;
    const { columns, rows, cell } = object.grid;
    const known = {
      id: object.id,
      grid: { columns, rows, cell: /** @type {Page.Size} */ (cell), width, height },
      revision: object.rest_revision ?? "",
      rest,
      region: null,
      setup: "",
      borrowed: false,
    };
    this.#known = known;
    this.#plans.want(known, () => this.#pose());
    this.#pose();
  }

  /**
   * The server's picture, when the pointer rests.
   *
   * @param {number} revision
   * @param {Page.Document} document
   * @param {boolean} isDragged
   */
  async #draw(revision, document, isDragged) {
    if (revision === this.#settled) return false;
    const left = this.#changed + REST - performance.now();
    if (isDragged || left > 0) {
      // The end of a drag is no change of the document.
      this.#timer = setTimeout(() => this.#run(), isDragged ? REST : left);
      return false;
    }
    const { signal } = this.#end;
    const session = /** @type {Session} */ (this.#session);
    const q = wire(document, "q");
    await this.#plans.arrived;
    const needsMesh = !this.#plans.of(this.#known);
    const [drawn, mesh] = await Promise.all([
      session.warp(q, { signal }),
      needsMesh ? session.mesh(q, { signal }) : null,
    ]);
    if (revision !== this.store.state.revision) return true;
    const { canvas } = drawn;
    const box =
      canvas && /** @type {Page.Box} */ ([canvas.x, canvas.y, canvas.width, canvas.height]);
    if (!(await this.view.showPng(drawn.blob, box, signal))) return true;
    if (revision !== this.store.state.revision) return true;
    if (mesh) {
      this.mesh = new Mesh(mesh, mesh.xy);
      this.view.setMesh(this.mesh);
    }
    this.residual = drawn.residual;
    this.#settled = revision;
    this.condition = "ready";
    this.told.shown();
    return false;
  }

  /**
   * The file of the shown pose.
   *
   * @param {{ format?: string, width?: number, quality?: number }} output
   * @returns {Promise<Blob>}
   */
  async file(output) {
    while (this.#running) await new Promise((resolve) => this.#waiting.push(() => resolve(null)));
    this.#end.signal.throwIfAborted();
    const { document } = this.store.state;
    if (!this.#session || this.#known?.rest !== JSON.stringify(restOf(document)))
      throw new DOMException("the server does not have the picture", "InvalidStateError");
    const wish = /** @type {import("../../../api/npm/client/contract.js").Output} */ (output);
    return (await this.#session.warp(wire(document, "q"), { output: wish })).blob;
  }
}
