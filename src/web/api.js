// The HTTP client. Addresses are relative to the page, so that a proxy may serve both under any
// path. Errors are thrown as a Problem: a problem document, or a missing response.

import { keyHeaders } from "./access.js";
import { boxFrom } from "./canvas.js";

export class Problem extends Error {
  constructor(members, status) {
    super(members.detail ?? members.title ?? "refused");
    Object.assign(this, { status, code: "internal", title: "", detail: "" }, members);
  }

  static async from(response) {
    try {
      return new Problem(await response.json(), response.status);
    } catch (error) {
      // Aborted while the body was read: not a response.
      if (wasAborted(error)) throw error;
      return Problem.ofStatus(response.status);
    }
  }

  /** An error without a problem document: it comes from a proxy, not from the service. */
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

const wasAborted = (error) => error?.name === "AbortError";
export { wasAborted };

async function ask(method, path, { json, file, accept, signal, media } = {}) {
  const headers = {
    ...keyHeaders(),
    ...(json ? { "Content-Type": "application/json" } : media && { "Content-Type": media }),
    ...(accept && { Accept: accept }),
  };
  let response;
  try {
    response = await fetch(path, {
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
  return response;
}

/** Reads a body; a broken connection is a network problem. */
async function read(response, how) {
  try {
    return await response[how]();
  } catch (error) {
    throw wasAborted(error) ? error : Problem.network();
  }
}

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
 * drags to one replica. XMLHttpRequest, because fetch reports no upload progress.
 */
export function openSession(file, name, rest, { progress, signal }) {
  return new Promise((resolve, reject) => {
    const form = new FormData();
    form.append("image", file, name);
    form.append("warp", new Blob([JSON.stringify(rest)], { type: "application/json" }));
    const request = new XMLHttpRequest();
    request.open("PUT", session(newName()));
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
      if (request.status < 300 && answer) resolve(answer);
      else
        reject(
          answer?.code ? new Problem(answer, request.status) : Problem.ofStatus(request.status),
        );
    };
    signal?.addEventListener("abort", () => request.abort());
    request.send(form);
  });
}

const session = (id) => `sessions/${encodeURIComponent(id)}`;

export const readSession = async (id) => read(await ask("GET", session(id)), "json");

export const putHandles = async (id, rest, signal) =>
  read(await ask("PUT", `${session(id)}/handles`, { json: rest, signal }), "json");

const region = (id) => `${session(id)}/layers/region`;

/**
 * The mask of the region, a picture of the size of the session's. The session then draws every
 * picture through it.
 */
export const putRegion = async (id, file) =>
  read(await ask("PUT", region(id), { file, media: file.type }), "json");
/** Deletes the mask, if there is one; returns the session. */
export async function deleteRegion(id) {
  await ask("DELETE", region(id)).catch((problem) => {
    if (problem.code !== "no_such_layer") throw problem;
  });
  return readSession(id);
}
export const readRegion = async (id, signal) =>
  read(await ask("GET", region(id), { signal }), "blob");

/** Many poses in one file, as a response that is read with `stream`. */
export const batch = (id, body, accept, signal) =>
  ask("POST", `${session(id)}/batch`, { json: body, accept, signal });

/** The parts of a body as they arrive. */
export async function* stream(response) {
  const reader = response.body.getReader();
  for (;;) {
    const { done, value } = await read(reader, "read");
    if (done) return;
    yield value;
  }
}

/** How well methods predict the handles: { best, candidates }. */
export const fit = async (id, body) =>
  read(await ask("POST", `${session(id)}/fit`, { json: body }), "json");

/** Annotations in the frame of the session's picture: { geojson }. */
export const points = async (id, body, signal) =>
  read(await ask("POST", `${session(id)}/points`, { json: body, signal }), "json");

/** The handles in a landmark file: { p, q (if the file has both sides), units }. */
export const readLandmarks = async (file) => read(await ask("POST", "landmarks", { file }), "json");

/** The handles of two landmark files, one for each side: { p, q, units }. */
export async function readSides(rest, pose) {
  const form = new FormData();
  form.append("landmarks_p", rest);
  form.append("landmarks_q", pose);
  return read(await ask("POST", "landmarks", { file: form }), "json");
}

/** The map that aligns q of a warp object: { class, matrix }. */
export const alignment = async (warp, extent) =>
  (await read(await ask("POST", "report", { json: { ...warp, extent } }), "json")).align;

/** The posed grid: f32, x and y of each vertex, row by row. */
export async function mesh(id, body, signal) {
  const response = await ask("POST", `${session(id)}/mesh`, {
    json: body,
    accept: "application/octet-stream",
    signal,
  });
  const bytes = await read(response, "arrayBuffer");
  return { places: floats(bytes, 0), report: reportOf(response, bytes.byteLength) };
}

/** The coefficients on a lattice, in half precision. */
export async function plan(id, columns, rows, signal) {
  const response = await ask(
    "GET",
    `${session(id)}/plan?columns=${columns}&rows=${rows}&precision=f16`,
    { signal },
  );
  return read(response, "arrayBuffer");
}

/** A picture, and the figures in its headers. */
export async function picture(id, body, signal) {
  const begun = performance.now();
  const response = await ask("POST", `${session(id)}/warp`, {
    json: body,
    accept: `image/${body.output?.format ?? "png"}`,
    signal,
  });
  const blob = await read(response, "blob");
  return { blob, report: { ...reportOf(response, blob.size), trip: performance.now() - begun } };
}

function reportOf(response, size) {
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

/** Reads little-endian f32 from a byte offset (a multiple of 4). */
export function floats(bytes, from) {
  if (LITTLE_ENDIAN) return new Float32Array(bytes, from);
  const view = new DataView(bytes, from);
  return Float32Array.from({ length: view.byteLength >> 2 }, (_, k) =>
    view.getFloat32(4 * k, true),
  );
}

/** The address of the drag socket. */
export function socketAddress(id, query) {
  const address = new URL(`${session(id)}/drag?${query}`, document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return address;
}
