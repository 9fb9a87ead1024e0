// An image on the server with its handles, and what is asked about its poses.

import { Drag } from "./drag.js";
import { ApiError, GONE } from "./errors.js";
import { json } from "./http.js";
import { floats, rendered } from "./rendered.js";

/** @typedef {import("./http.js").Http} Http */
/** @typedef {import("./rendered.js").Rendered} Rendered */
/** @typedef {import("./contract.js").Handle} Handle */
/** @typedef {import("./contract.js").WarpObject} WarpObject */
/** @typedef {import("./contract.js").Session} SessionObject */
/** @typedef {{ signal?: AbortSignal }} Abortable */
/**
 * A pose: its handles, or an object with them, such as `{ q, strength: 0.5 }`. Without `q` the
 * session's own pose is meant.
 *
 * @template T
 * @typedef {Handle[] | T} PoseOf
 */

/**
 * What is kept to upload an expired session again.
 *
 * @typedef {{
 *   upload: (warp: WarpObject, signal?: AbortSignal) => Promise<SessionObject>,
 *   warp: WarpObject,
 * }} Kept
 */

/**
 * The posed grid: `xy` has the positions of the vertices, row by row, px of the source.
 *
 * @typedef {{
 *   columns: number,
 *   rows: number,
 *   width: number,
 *   height: number,
 *   cell: [number, number],
 *   xy: Float32Array,
 * }} Mesh
 */

/**
 * @template {object} T
 * @param {PoseOf<T>} pose
 * @returns {T}
 */
const body = (pose) => /** @type {T} */ (Array.isArray(pose) ? { q: pose } : pose);

export class Session {
  /** @type {Http} */
  #http;
  /** @type {Kept | null} */
  #kept;
  /** @type {Map<string, { file: Blob, kind: "image" | "labels" }>} */
  #layers = new Map();
  /** @type {Promise<void> | null} */
  #reopening = null;

  /**
   * @param {Http} http
   * @param {string} id
   * @param {SessionObject | null} object
   * @param {Kept | null} kept
   */
  constructor(http, id, object, kept) {
    this.#http = http;
    this.id = id;
    /**
     * What the server last said of the session: its size, handles, grid, when it expires.
     *
     * @type {SessionObject | null}
     */
    this.object = object;
    this.#kept = kept;
  }

  get #path() {
    return `sessions/${encodeURIComponent(this.id)}`;
  }

  /**
   * @template T
   * @param {string} method
   * @param {string} path
   * @param {import("./http.js").Asked<T>} asked
   * @returns {Promise<T>}
   */
  async #ask(method, path, asked) {
    const send = () => this.#http.ask(method, `${this.#path}${path}`, asked);
    try {
      return await send();
    } catch (error) {
      if (!(error instanceof ApiError && GONE.has(error.code) && (await this.reopened())))
        throw error;
      asked.signal?.throwIfAborted();
      return send();
    }
  }

  /**
   * Uploads the session again if it was opened so; false if it cannot. Concurrent requests share
   * one upload.
   *
   * @returns {Promise<boolean>}
   */
  async reopened() {
    const kept = this.#kept;
    if (!kept) return false;
    this.#reopening ??= (async () => {
      this.object = await kept.upload(kept.warp);
      for (const [name, { file, kind }] of this.#layers) await this.#sendLayer(name, file, kind);
    })().finally(() => (this.#reopening = null));
    await this.#reopening;
    return true;
  }

  /**
   * Asks for the session object.
   *
   * @param {Abortable & { maxRetries?: number }} [options]
   * @returns {Promise<SessionObject>}
   */
  async refresh({ signal, maxRetries: retries } = {}) {
    const read = json;
    return (this.object = await this.#http.ask("GET", this.#path, { signal, retries, read }));
  }

  /**
   * Replaces the handles at rest, the method or other settings, without an upload.
   *
   * @param {WarpObject} warp
   * @param {Abortable} [options]
   * @returns {Promise<SessionObject>}
   */
  async putHandles(warp, { signal } = {}) {
    this.object = await this.#ask("PUT", "/handles", { json: warp, signal, read: json });
    if (this.#kept) this.#kept.warp = { ...this.#kept.warp, ...warp };
    return /** @type {SessionObject} */ (this.object);
  }

  /**
   * The picture of a pose. `accept`: a media type, if `output.format` is not given.
   *
   * @param {PoseOf<import("./contract.js").Drag>} pose
   * @param {Abortable & { output?: import("./contract.js").Output, accept?: string }} [options]
   * @returns {Promise<Rendered>}
   */
  warp(pose, { output, accept, signal } = {}) {
    const json = { ...body(pose), ...(output && { output }) };
    return this.#ask("POST", "/warp", { json, accept, signal, read: rendered });
  }

  /**
   * The grid of a pose, for clients that draw themselves.
   *
   * @param {PoseOf<import("./contract.js").PosedHandlesOnly>} pose
   * @param {Abortable} [options]
   * @returns {Promise<Mesh>}
   */
  async mesh(pose, { signal } = {}) {
    const read = async (/** @type {Response} */ response) =>
      floats(await response.arrayBuffer(), 0);
    const accept = "application/octet-stream";
    const asked = { json: body(pose), accept, signal, read };
    const [{ image, grid }, xy] = await Promise.all([
      this.object ?? this.refresh({ signal }),
      this.#ask("POST", "/mesh", asked),
    ]);
    const { columns, rows, cell } = grid;
    const { width, height } = image;
    return { columns, rows, width, height, cell: /** @type {[number, number]} */ (cell), xy };
  }

  /**
   * The coefficients of the handles at rest, with which a client poses the grid itself: the bytes
   * of the file that the guide describes.
   *
   * @param {Abortable & { columns?: number, rows?: number, precision?: "f32" | "f16" }} [options]
   * @returns {Promise<ArrayBuffer>}
   */
  plan({ signal, ...options } = {}) {
    const given = Object.entries(options).filter(([, value]) => value !== undefined);
    const query = new URLSearchParams(given.map(([name, value]) => [name, String(value)]));
    const read = (/** @type {Response} */ response) => response.arrayBuffer();
    return this.#ask("GET", `/plan?${query}`, { signal, read });
  }

  /**
   * Maps points, polygons, boxes or GeoJSON by a pose, or with `inverse` back from it.
   *
   * @param {import("./contract.js").PosedPoints} annotations
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").PointsAnswer>}
   */
  points(annotations, { signal } = {}) {
    return this.#ask("POST", "/points", { json: annotations, signal, read: json });
  }

  /**
   * A pose as an array of positions: `.npy`, or with `accept: "image/tiff"` TIFF.
   *
   * @param {PoseOf<import("./contract.js").PosedMap>} pose
   * @param {Abortable & { accept?: string }} [options]
   * @returns {Promise<Rendered>}
   */
  map(pose, { accept, signal } = {}) {
    return this.#ask("POST", "/map", { json: body(pose), accept, signal, read: rendered });
  }

  /**
   * Measures a pose: residuals, folds, distortion, coverage.
   *
   * @param {PoseOf<import("./contract.js").PosedReport>} pose
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").ReportAnswer>}
   */
  report(pose, { signal } = {}) {
    return this.#ask("POST", "/report", { json: body(pose), signal, read: json });
  }

  /**
   * Which method predicts the handles of a pose best.
   *
   * @param {PoseOf<import("./contract.js").PosedFit>} pose
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").FitAnswer>}
   */
  fit(pose, { signal } = {}) {
    return this.#ask("POST", "/fit", { json: body(pose), signal, read: json });
  }

  /**
   * Many poses in one file: a zip archive, or with `accept` an animation (`image/gif`,
   * `image/apng`). The answer is a stream, its `body`, that has no time limit.
   *
   * @param {import("./contract.js").Batch} poses
   * @param {Abortable & { accept?: string }} [options]
   * @returns {Promise<Response>}
   */
  batch(poses, { accept, signal } = {}) {
    return this.#ask("POST", "/batch", { json: poses, accept, signal, read: (answer) => answer });
  }

  /**
   * Stores a further image of the same size, which follows the warp; `region` restricts it.
   *
   * @param {string} name
   * @param {Blob | BufferSource} file
   * @param {Abortable & { kind?: "image" | "labels" }} [options]
   * @returns {Promise<SessionObject>}
   */
  async putLayer(name, file, { kind = "image", signal } = {}) {
    const blob = file instanceof Blob ? file : new Blob([/** @type {BlobPart} */ (file)]);
    this.object = await this.#ask("PUT", layer(name, kind), {
      body: blob,
      type: blob.type || "application/octet-stream",
      signal,
      read: json,
    });
    if (this.#kept) this.#layers.set(name, { file: blob, kind });
    return /** @type {SessionObject} */ (this.object);
  }

  /**
   * @param {string} name
   * @param {Blob} file
   * @param {"image" | "labels"} kind
   */
  async #sendLayer(name, file, kind) {
    const type = file.type || "application/octet-stream";
    const asked = { body: file, type, read: json };
    this.object = await this.#http.ask("PUT", `${this.#path}${layer(name, kind)}`, asked);
  }

  /**
   * The file of a layer, as it was stored.
   *
   * @param {string} name
   * @param {Abortable} [options]
   * @returns {Promise<Blob>}
   */
  layer(name, { signal } = {}) {
    return this.#ask("GET", layer(name), { signal, read: (answer) => answer.blob() });
  }

  /**
   * @param {string} name
   * @param {Abortable} [options]
   * @returns {Promise<void>}
   */
  async deleteLayer(name, { signal } = {}) {
    await this.#ask("DELETE", layer(name), { signal, read: () => {} });
    this.#layers.delete(name);
  }

  /**
   * A token for this session alone, which a server with the key gives to a browser.
   *
   * @param {Abortable & {
   *   ops?: import("./contract.js").TokenOperation[],
   *   ttl?: number,
   *   maxBytes?: number,
   * }} [options] `ttl`: seconds
   * @returns {Promise<import("./contract.js").SessionToken>}
   */
  token({ ops, ttl, maxBytes: max_bytes, signal } = {}) {
    return this.#ask("POST", "/tokens", { json: { ops, ttl, max_bytes }, signal, read: json });
  }

  /**
   * Opens a drag: poses in, frames out, the newest pose wins.
   *
   * @param {import("./drag.js").DragOptions} [options]
   */
  drag(options) {
    return new Drag(this.#http, this, options);
  }

  /**
   * Deletes the session on the server. One that is not there any more is deleted.
   *
   * @param {Abortable & { keepalive?: boolean }} [options]
   * @returns {Promise<void>}
   */
  async delete({ signal, keepalive } = {}) {
    this.#kept = null;
    try {
      await this.#http.ask("DELETE", this.#path, { signal, keepalive, read: () => {} });
    } catch (error) {
      if (!(error instanceof ApiError && GONE.has(error.code))) throw error;
    }
  }

  /** For `await using`: deletes the session; the server forgets it anyway if that fails. */
  async [Symbol.asyncDispose]() {
    await this.delete({ keepalive: true }).catch(() => {});
  }
}

/**
 * @param {string} name
 * @param {"image" | "labels"} [kind]
 */
const layer = (name, kind) =>
  `/layers/${encodeURIComponent(name)}${kind === "labels" ? "?kind=labels" : ""}`;
