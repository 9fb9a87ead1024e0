// The warp by a server: a session with the picture, the coefficients that pose the preview here, a
// drag socket until they have arrived, and the server's own picture when the pointer rests.

import { ApiError } from "../../../api/npm/client/index.js";
import { restOf, wire } from "../edits.js";
import { Mesh } from "../mesh.js";
import { Plans } from "../plan.js";
import { Follower, arrayOfBox, sides } from "./follower.js";

/** @typedef {import("../../../api/npm/client/index.js").Client} Client */
/** @typedef {import("../../../api/npm/client/index.js").Session} Session */
/** @typedef {import("../../../api/npm/client/index.js").Frame} Frame */
/** @typedef {import("../../../api/npm/client/session.js").SessionObject} SessionObject */
/** @typedef {import("../../../api/npm/client/contract.js").WarpObject} Warp */

export class Remote extends Follower {
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

  /**
   * @param {Client} client
   * @param {string | undefined} id of the session, if the site has chosen it
   * @param {Blob} blob
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {import("./follower.js").Told} told
   * @param {Session | null} session one that exists, and whose handles are those of the document
   */
  constructor(client, id, blob, store, view, told, session) {
    super(store, view, told);
    this.client = client;
    this.id = id;
    this.blob = blob;
    if (session?.object) {
      this.#session = session;
      this.#hear(session.object, JSON.stringify(restOf(store.state.document)));
    }
    this.follow();
  }

  /** The session is deleted if it was opened here. */
  release() {
    super.release();
    this.#plans.drop();
    this.#drag?.close();
    if (!this.id) this.#session?.delete({ keepalive: true }).catch(() => {});
  }

  /** @param {unknown} error */
  isPassing(error) {
    return (
      !(error instanceof ApiError) ||
      error.status === 408 ||
      error.status === 429 ||
      error.status > 500
    );
  }

  /** @param {string} words */
  has(words) {
    return this.#known?.rest === words;
  }

  /**
   * @param {Page.Rest} given
   * @param {string} words
   */
  async take(given, words) {
    const { signal } = this;
    const rest = /** @type {Warp} */ (given);
    if (this.#session) await this.#session.putHandles(rest, { signal });
    else {
      const options = { id: this.id, reopen: true, signal };
      this.#session = await this.client.open(this.blob, rest, options);
    }
    this.#hear(/** @type {SessionObject} */ (this.#session.object), words);
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
    this.#plans.want(known, () => this.pose());
  }

  /**
   * By the coefficients; without them, in a drag, by the socket.
   *
   * @param {Page.Document} document
   * @param {number} revision
   */
  preview(document, revision) {
    const plan = this.view.webgl === "none" ? null : this.#plans.of(this.#known);
    const [p, q] = sides(document);
    if (plan) {
      const mesh = plan.pose(p, q);
      this.show(mesh, revision);
      this.residual = plan.residual(mesh, p, q);
    } else if (this.store.state.before) {
      // The server closes that of a window that shows nothing for long.
      if (this.#drag?.state === "closed") this.#drag = null;
      this.#drag ??= this.#open();
      this.#poses.set(this.#drag.pose(q), revision);
    }
  }

  #open() {
    const isPlain = this.view.webgl === "none";
    const wish = isPlain ? { frames: /** @type {const} */ ("png") } : { compact: true };
    const drag = /** @type {Session} */ (this.#session).drag({ ...wish, signal: this.signal });
    drag.addEventListener("frame", (event) => {
      event.preventDefault();
      this.#showFrame(/** @type {Event & { frame: Frame }} */ (event).frame);
    });
    drag.addEventListener("problem", (event) =>
      this.told.problem(/** @type {Event & { error: ApiError }} */ (event).error),
    );
    return drag;
  }

  /** @param {Frame} frame */
  #showFrame(frame) {
    const revision = this.#poses.get(frame.pose) ?? -1;
    for (const old of this.#poses.keys()) if (old < frame.pose) this.#poses.delete(old);
    if (revision <= Math.max(this.live, this.settled)) return frame.ack();
    if (frame.mesh) this.show(new Mesh(frame.mesh, frame.mesh.xy), revision, () => frame.ack());
    else if (frame.blob)
      this.view.showFrame(frame.blob, arrayOfBox(frame.report?.canvas)).then(() => frame.ack());
  }

  /**
   * The server's picture.
   *
   * @param {Page.Document} document
   * @returns {Promise<import("./follower.js").Drawn>}
   */
  async draw(document) {
    const { signal } = this;
    const session = /** @type {Session} */ (this.#session);
    const q = wire(document, "q");
    await this.#plans.arrived;
    const [{ blob, canvas, residual }, mesh] = await Promise.all([
      session.warp(q, { signal }),
      this.#plans.of(this.#known) ? null : session.mesh(q, { signal }),
    ]);
    return { blob, box: arrayOfBox(canvas), mesh: mesh && new Mesh(mesh, mesh.xy), residual };
  }

  /**
   * @param {Page.Document} document
   * @param {import("./follower.js").FileOptions} output
   */
  async fileOf(document, output) {
    const wish = /** @type {Warp["output"]} */ (output);
    const session = /** @type {Session} */ (this.#session);
    return (await session.warp(wire(document, "q"), { output: wish })).blob;
  }
}
