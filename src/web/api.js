// The HTTP client. Addresses are relative to the page, so that a proxy may serve both under any
// path. Errors are thrown as a Problem: a problem document, or a missing response.

import { acceptKey, keyHeaders, tokenSession } from "./access.js";
import { boxFrom } from "./canvas.js";
import { known } from "./dom.js";
import { does, send } from "./service.js";

/**
 * The members of a problem document (api/problems.md), and what the page adds. Others are read by
 * nobody.
 *
 * @typedef {{
 *   code?: string,
 *   title?: string,
 *   detail?: string,
 *   handle?: number,
 *   coincident?: { handles: number[] }[],
 *   items?: string[][],
 *   item_count?: number,
 *   pointer?: string,
 *   request_id?: string,
 *   retry_after?: number,
 *   link?: boolean,
 *   opening?: boolean,
 * }} ProblemMembers
 */

/**
 * @typedef {{ json?: object, file?: Blob | FormData, accept?: string, signal?: AbortSignal, media?:
 * string }} Asked
 */

export class Problem extends Error {
  /** @type {boolean | undefined} */
  #canMove;

  /**
   * @param {ProblemMembers} members
   * @param {number} status
   */
  constructor(members, status) {
    super(members.detail ?? members.title ?? "refused");
    this.status = status;
    this.code = "internal";
    this.title = "";
    this.detail = "";
    /** @type {ProblemMembers["handle"]} */
    this.handle = undefined;
    /** @type {ProblemMembers["coincident"]} */
    this.coincident = undefined;
    /** Indices of the handles beside the outline, as far as this page sees. @type {number[]} */
    this.beside = [];
    /** Finds whether they can be moved to places inside. @type {() => boolean} */
    this.findMove = () => false;
    /** @type {ProblemMembers["items"]} */
    this.items = undefined;
    /** @type {ProblemMembers["item_count"]} */
    this.item_count = undefined;
    /** @type {ProblemMembers["pointer"]} */
    this.pointer = undefined;
    /** @type {ProblemMembers["request_id"]} */
    this.request_id = undefined;
    /** @type {ProblemMembers["retry_after"]} */
    this.retry_after = undefined;
    /** Whether it is about a link. */
    this.link = false;
    /** Whether something could not be opened: the page is as it was. */
    this.opening = false;
    Object.assign(this, members);
  }

  /** Whether the handles beside the outline can be moved to places inside: found when it is shown. */
  get canMoveInside() {
    return (this.#canMove ??= this.findMove());
  }

  /** @param {Response} response */
  static async from(response) {
    try {
      return new Problem(await response.json(), response.status);
    } catch (error) {
      // Aborted while the body was read: not a response.
      if (wasAborted(error)) throw error;
      return Problem.ofStatus(response.status);
    }
  }

  /**
   * An error without a problem document: it comes from a proxy, not from the service.
   * @param {number} status
   */
  static ofStatus(status) {
    const code =
      { 413: "too_large", 429: "rate_limited", 502: "network", 503: "overloaded", 504: "timeout" }[
        status
      ] ?? "internal";
    return new Problem(
      {
        code,
        title: `Status ${status}`,
        detail: "A proxy between this page and the server rejected the request.",
      },
      status,
    );
  }

  static network() {
    return new Problem({ code: "network", title: "No response", detail: "" }, 0);
  }
}

/** @type {(error: unknown) => boolean} */
const wasAborted = (error) => error instanceof DOMException && error.name === "AbortError";
export { wasAborted };

/**
 * A Problem as what it is; anything else is an error of this page, and stays one.
 *
 * @param {unknown} error
 */
export function asProblem(error) {
  if (error instanceof Problem) return error;
  throw error;
}

/**
 * @param {string} method
 * @param {string} path
 * @param {Asked} [asked]
 */
async function ask(method, path, { json, file, accept, signal, media } = {}) {
  /** @type {Record<string, string>} */
  const headers = {
    ...keyHeaders(),
    ...(json ? { "Content-Type": "application/json" } : media && { "Content-Type": media }),
    ...(accept && { Accept: accept }),
  };
  let response;
  try {
    response = await send(path, {
      method,
      headers,
      body: json ? JSON.stringify(json) : file,
      signal,
      cache: "no-store",
    });
  } catch (error) {
    throw wasAborted(error) ? error : Problem.network();
  }
  if (!response.ok) throw await Problem.from(response);
  acceptKey();
  return response;
}

/**
 * Reads a body; a broken connection is a network problem.
 * @template T
 * @param {() => Promise<T>} how
 * @returns {Promise<T>}
 */
async function read(how) {
  try {
    return await how();
  } catch (error) {
    throw wasAborted(error) ? error : Problem.network();
  }
}

/** @type {(response: Response) => Promise<Page.Json>} */
const jsonOf = (response) => read(() => response.json());

/** @type {(response: Response) => Promise<Blob>} */
const blobOf = (response) => read(() => response.blob());

/** A version 4 UUID. `crypto.randomUUID` is unavailable on pages served over plain HTTP. */
function newName() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  bytes[6] = (bytes[6] & 0x0f) | 0x40;
  bytes[8] = (bytes[8] & 0x3f) | 0x80;
  const hex = Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
  return hex.replace(/^(.{8})(.{4})(.{4})(.{4})(.{12})$/, "$1-$2-$3-$4-$5");
}

/**
 * PUT /sessions/{uuid}: with a client-chosen id, so that a proxy that hashes ids sends upload and
 * drags to one replica; with a token, that of its session. XMLHttpRequest, because fetch reports no upload progress.
 * @param {Blob} file
 * @param {string} name
 * @param {Page.Rest} rest
 * @param {{ progress?: (percent: number) => void, signal?: AbortSignal }} how
 * @returns {Promise<Page.SessionObject>}
 */
export async function openSession(file, name, rest, { progress, signal }) {
  const form = new FormData();
  form.append("image", file, name);
  form.append("warp", new Blob([JSON.stringify(rest)], { type: "application/json" }));
  const path = session(tokenSession() ?? newName());
  if (!does.transport) return jsonOf(await ask("PUT", path, { file: form, signal }));
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("PUT", path);
    for (const [name, value] of Object.entries(keyHeaders())) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) =>
      event.lengthComputable && progress?.((100 * event.loaded) / event.total);
    request.onerror = () => reject(Problem.network());
    request.onabort = () => reject(new DOMException("cancelled", "AbortError"));
    request.onload = () => {
      let answer = null;
      try {
        answer = JSON.parse(request.responseText);
      } catch {
        // Reported by its status below.
      }
      if (request.status < 300 && answer) {
        acceptKey();
        resolve(answer);
      } else
        reject(
          answer?.code ? new Problem(answer, request.status) : Problem.ofStatus(request.status),
        );
    };
    signal?.addEventListener("abort", () => request.abort());
    request.send(form);
  });
}

/** @type {(id: string) => string} */
const session = (id) => `sessions/${encodeURIComponent(id)}`;

/** @type {(id: string) => Promise<Page.SessionObject>} */
export const readSession = async (id) => jsonOf(await ask("GET", session(id)));

/** @type {(id: string, rest: Page.Rest, signal?: AbortSignal) => Promise<Page.SessionObject>} */
export const putHandles = async (id, rest, signal) =>
  jsonOf(await ask("PUT", `${session(id)}/handles`, { json: rest, signal }));

/** @type {(id: string) => string} */
const region = (id) => `${session(id)}/layers/region`;

/**
 * The mask of the region, a picture of the size of the session's. The session then draws every
 * picture through it.
 * @type {(id: string, file: Blob) => Promise<Page.SessionObject>}
 */
export const putRegion = async (id, file) =>
  jsonOf(await ask("PUT", region(id), { file, media: file.type }));
/**
 * Deletes the mask, if there is one; returns the session.
 * @param {string} id
 */
export async function deleteRegion(id) {
  await ask("DELETE", region(id)).catch((error) => {
    if (asProblem(error).code !== "no_such_layer") throw error;
  });
  return readSession(id);
}
/** @type {(id: string, signal: AbortSignal) => Promise<Blob>} */
export const readRegion = async (id, signal) => blobOf(await ask("GET", region(id), { signal }));

/** A session that is not needed any more; without it, the server forgets it later.
 * @type {(id: string) => Promise<unknown>}
 */
export const deleteSession = (id) => ask("DELETE", session(id)).catch(() => null);

/**
 * Several images in one, or a file of several.
 * @type {(body: object, accept: string) => Promise<Blob>}
 */
export const blend = async (body, accept) =>
  blobOf(await ask("POST", "blend", { json: body, accept }));

/**
 * Many poses in one file, as a response that is read with `stream`.
 * @type {(id: string, body: object, accept: string, signal: AbortSignal) => Promise<Response>}
 */
export const batch = (id, body, accept, signal) =>
  ask("POST", `${session(id)}/batch`, { json: body, accept, signal });

/**
 * The parts of a body as they arrive.
 * @param {Response} response
 * @returns {AsyncGenerator<Uint8Array<ArrayBuffer>>}
 */
export async function* stream(response) {
  const reader = known(response.body).getReader();
  for (;;) {
    const { done, value } = await read(() => reader.read());
    if (done) return;
    yield value;
  }
}

/**
 * How well methods predict the handles: { best, candidates }.
 * @type {(id: string, body: Page.Pose) => Promise<{ best: Page.FitBest, candidates:
 * Page.FitCandidate[] }>}
 */
export const fit = async (id, body) =>
  jsonOf(await ask("POST", `${session(id)}/fit`, { json: body }));

/**
 * Annotations in the frame of the session's picture: { geojson }.
 * @type {(id: string, body: object, signal?: AbortSignal) => Promise<{ geojson: Page.Json }>}
 */
export const points = async (id, body, signal) =>
  jsonOf(await ask("POST", `${session(id)}/points`, { json: body, signal }));

/**
 * The handles in a landmark file: { p, q (if the file has both sides), names (if it has any), units }.
 * `item`: which of several; `extent`: the size of the picture.
 * @param {Blob} file
 * @param {{ item?: number | string, extent?: Page.Size }} [how]
 * @returns {Promise<Page.Landmarks>}
 */
export async function readLandmarks(file, { item, extent } = {}) {
  const query = new URLSearchParams({
    ...(item !== undefined && { item: String(item) }),
    ...(extent && { extent_p: extent.join() }),
  });
  return jsonOf(await ask("POST", `landmarks${query.size ? `?${query}` : ""}`, { file }));
}

/**
 * The handles of two landmark files, one for each side: { p, q, units }. `extent`: the size of the
 * picture.
 * @param {Blob} rest
 * @param {Blob} pose
 * @param {Page.Size} [extent]
 * @returns {Promise<Page.Landmarks & { q: Page.Landmarks["p"] }>}
 */
export async function readSides(rest, pose, extent) {
  const form = new FormData();
  form.append("landmarks_p", rest);
  form.append("landmarks_q", pose);
  if (extent) for (const side of ["p", "q"]) form.append(`extent_${side}`, extent.join());
  return jsonOf(await ask("POST", "landmarks", { file: form }));
}

/**
 * The map that aligns q of a warp object: { class, matrix }.
 * @type {(warp: object, extent: Page.Size) => Promise<{ matrix: number[][] }>}
 */
export const alignment = async (warp, extent) =>
  (await jsonOf(await ask("POST", "report", { json: { ...warp, extent } }))).align;

/**
 * The posed grid: f32, x and y of each vertex, row by row.
 * @param {string} id
 * @param {Page.Pose} body
 * @param {AbortSignal} [signal]
 */
export async function mesh(id, body, signal) {
  const response = await ask("POST", `${session(id)}/mesh`, {
    json: body,
    accept: "application/octet-stream",
    signal,
  });
  const bytes = await read(() => response.arrayBuffer());
  return { places: floats(bytes, 0), report: reportOf(response, bytes.byteLength) };
}

/**
 * The coefficients on a lattice, in half precision.
 * @param {string} id
 * @param {number} columns
 * @param {number} rows
 * @param {AbortSignal} signal
 * @returns {Promise<ArrayBuffer>}
 */
export async function plan(id, columns, rows, signal) {
  const response = await ask(
    "GET",
    `${session(id)}/plan?columns=${columns}&rows=${rows}&precision=f16`,
    { signal },
  );
  return read(() => response.arrayBuffer());
}

/**
 * A picture, and the figures in its headers.
 * @param {string} id
 * @param {Page.Pose} body
 * @param {AbortSignal} [signal]
 */
export async function picture(id, body, signal) {
  const begun = performance.now();
  const response = await ask("POST", `${session(id)}/warp`, {
    json: body,
    accept: `image/${body.output?.format ?? "png"}`,
    signal,
  });
  const blob = await blobOf(response);
  return { blob, report: { ...reportOf(response, blob.size), trip: performance.now() - begun } };
}

/**
 * @param {Response} response
 * @param {number} size
 * @returns {Page.Report}
 */
function reportOf(response, size) {
  /** @type {Page.Report["timing"]} */
  const timing = {};
  for (const entry of (response.headers.get("Server-Timing") ?? "").split(",")) {
    const [, name, ms] = /^\s*([\w-]+)\s*;\s*dur=([\d.]+)/.exec(entry) ?? [];
    if (name) timing[name] = Number(ms);
  }
  const warnings = (response.headers.get("Warp-Warning") ?? "")
    .split(",")
    .map((w) => w.trim())
    .filter(Boolean);
  return {
    timing,
    size,
    folds: Number(response.headers.get("Warp-Folds") ?? 0),
    residual: Number(response.headers.get("Warp-Residual") ?? 0),
    warnings,
    canvas: boxFrom(response.headers.get("Warp-Canvas")),
  };
}

const LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

/**
 * Reads little-endian f32 from a byte offset (a multiple of 4).
 * @param {ArrayBuffer} bytes
 * @param {number} from
 */
export function floats(bytes, from) {
  if (LITTLE_ENDIAN) return new Float32Array(bytes, from);
  const view = new DataView(bytes, from);
  return Float32Array.from({ length: view.byteLength >> 2 }, (_, k) =>
    view.getFloat32(4 * k, true),
  );
}

/**
 * The address of the drag socket.
 * @param {string} id
 * @param {string} query
 */
export function socketAddress(id, query) {
  const address = new URL(`${session(id)}/drag?${query}`, document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return address;
}
