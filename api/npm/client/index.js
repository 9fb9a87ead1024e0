// A client of the service, over `fetch` and WebSocket, for browsers and Node. `api/openapi.json`
// describes what the objects contain; their types are generated from it.

import { jsonOf } from "../engine/json.js";
import { Drag } from "./drag.js";
import { ApiError, ConnectionFailed } from "./errors.js";
import { Http, json } from "./http.js";
import { rendered } from "./rendered.js";
import { Session } from "./session.js";

export { ApiError, ConnectionFailed, Drag, Session };

/** @typedef {import("./http.js").ClientOptions} ClientOptions */
/** @typedef {import("./rendered.js").Rendered} Rendered */
/** @typedef {import("./drag.js").Frame} Frame */
/** @typedef {import("./drag.js").DragOptions} DragOptions */
/** @typedef {import("./drag.js").Grid} Grid */
/** @typedef {import("./session.js").Mesh} Mesh */
/** @typedef {import("./contract.js").Handle} Handle */
/** @typedef {import("./contract.js").WarpObject} WarpObject */
/** @typedef {import("./contract.js").Problem} Problem */
/** @typedef {Blob | BufferSource} File */
/** @typedef {{ signal?: AbortSignal }} Abortable */

/** @type {(file: File) => Blob} */
const blobOf = (file) => (file instanceof Blob ? file : new Blob([/** @type {BlobPart} */ (file)]));

/**
 * A form of files and JSON, in this order.
 *
 * @param {Record<string, File | File[] | object | undefined>} parts
 * @param {string} object the name of the part that is JSON
 */
function form(parts, object) {
  const made = new FormData();
  for (const [name, content] of Object.entries(parts)) {
    if (content === undefined) continue;
    if (name === object) made.set(name, new Blob([jsonOf(content)], { type: "application/json" }));
    else
      for (const file of /** @type {File[]} */ ([content].flat())) made.append(name, blobOf(file));
  }
  return made;
}

/** A server, and what is the same in every request to it. */
export class Client {
  /** @type {Http} */
  #http;
  /** @type {ClientOptions} */
  #options;

  /**
   * `server`: its address. `auth`: an API key, or a function that gets a session token; it is asked
   * again when the token has expired. `timeout`: ms that an answer may take. `maxRetries`: how
   * often a request is sent again if the server cannot be reached or is busy (408, 429, 502, 503,
   * 504; never 409). `WebSocket`: for Node 20, that of the package `ws`.
   *
   * @param {ClientOptions} options
   */
  constructor(options) {
    this.#options = options;
    this.#http = new Http(options);
  }

  /** The address of the server. */
  get server() {
    return this.#http.server;
  }

  /**
   * The same server with other options.
   *
   * @param {Partial<ClientOptions>} options
   */
  with(options) {
    return new Client({ ...this.#options, ...options });
  }

  /**
   * Warps a file once. For several poses of one file, `open` a session.
   *
   * @param {File} file
   * @param {WarpObject} warp
   * @param {Abortable & { region?: File }} [options]
   * @returns {Promise<Rendered>}
   */
  warp(file, warp, { region, signal } = {}) {
    const body = form({ image: file, region, warp }, "warp");
    return this.#http.ask("POST", "warp", { body, signal, read: rendered });
  }

  /**
   * Uploads a file with its handles at rest, for poses that send only `q`. The id is chosen here,
   * so that the upload can be repeated; a token names its session, which is then `id`. With
   * `reopen`, a session that has expired is uploaded again, from memory, with its layers.
   *
   * @param {File} file
   * @param {WarpObject} [warp]
   * @param {Abortable & { id?: string, region?: File, reopen?: boolean }} [options]
   * @returns {Promise<Session>}
   */
  async open(file, warp = {}, { id = newId(), region, reopen = false, signal } = {}) {
    /** @type {import("./session.js").Kept["upload"]} */
    const upload = (rest, signal) =>
      this.#http.ask("PUT", `sessions/${id}`, {
        body: form({ image: file, region, warp: rest }, "warp"),
        signal,
        read: json,
      });
    const object = await upload(warp, signal);
    return new Session(this.#http, id, object, reopen ? { upload, warp } : null);
  }

  /**
   * A session that exists, such as one that your own server has opened. Nothing is requested.
   *
   * @param {string} id
   */
  session(id) {
    return new Session(this.#http, id, null, null);
  }

  /**
   * Maps points, polygons, boxes or GeoJSON by a warp of an image of this `extent`.
   *
   * @param {import("./contract.js").Points} annotations
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").PointsAnswer>}
   */
  points(annotations, { signal } = {}) {
    return this.#http.ask("POST", "points", { json: annotations, signal, read: json });
  }

  /**
   * The warp itself, as an array of positions: `.npy`, or with `accept: "image/tiff"` TIFF.
   *
   * @param {import("./contract.js").Map} warp
   * @param {Abortable & { accept?: string }} [options]
   * @returns {Promise<Rendered>}
   */
  map(warp, { accept, signal } = {}) {
    return this.#http.ask("POST", "map", { json: warp, accept, signal, read: rendered });
  }

  /**
   * Measures a warp: residuals, folds, distortion, coverage.
   *
   * @param {import("./contract.js").Report} warp
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").ReportAnswer>}
   */
  report(warp, { signal } = {}) {
    return this.#http.ask("POST", "report", { json: warp, signal, read: json });
  }

  /**
   * Which method predicts the handles best.
   *
   * @param {import("./contract.js").Fit} handles
   * @param {Abortable} [options]
   * @returns {Promise<import("./contract.js").FitAnswer>}
   */
  fit(handles, { signal } = {}) {
    return this.#http.ask("POST", "fit", { json: handles, signal, read: json });
  }

  /**
   * Reads one landmark file with both sides, or one for each side: a warp object.
   *
   * @param {File | { p: File, q: File }} files
   * @param {Abortable & { extent?: [number, number] }} [options] `extent`: the size, in px, that
   *   the positions of a thumbnail are counted in
   * @returns {Promise<import("./contract.js").Landmarks>}
   */
  landmarks(files, { extent, signal } = {}) {
    const sides = /** @type {{ p?: File, q?: File }} */ (files);
    const body =
      sides.p && sides.q
        ? form({ landmarks_p: sides.p, landmarks_q: sides.q }, "")
        : form({ landmarks: /** @type {File} */ (files) }, "");
    if (extent) body.set("extent_p", extent.join());
    return this.#http.ask("POST", "landmarks", { body, signal, read: json });
  }

  /**
   * Adds images whose handles are brought to the same place: an average, or the frames of a morph.
   * `landmarks`: a file for each image, in place of handles in `blend`.
   *
   * @param {File[]} images
   * @param {import("./contract.js").Blend} blend
   * @param {Abortable & { landmarks?: File[], accept?: string }} [options]
   * @returns {Promise<Rendered>}
   */
  blend(images, blend, { landmarks, accept, signal } = {}) {
    const body = form({ image: images, landmarks, blend }, "blend");
    return this.#http.ask("POST", "blend", { body, accept, signal, read: rendered });
  }
}

/** A version 4 UUID. `crypto.randomUUID` is unavailable on pages served over plain HTTP. */
function newId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  bytes[6] = (bytes[6] & 0x0f) | 0x40;
  bytes[8] = (bytes[8] & 0x3f) | 0x80;
  const hex = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  return hex.replace(/^(.{8})(.{4})(.{4})(.{4})(.{12})$/, "$1-$2-$3-$4-$5");
}
