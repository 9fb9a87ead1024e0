// On a static host: what the page asks of a server (api/openapi.json), answered by the engine. Not
// served by the program.

import { boxFrom } from "../canvas.js";
import { known } from "../dom.js";
import { isOutlined } from "../edits.js";
import { EASINGS } from "../player.js";
import { AnimatedPng } from "./apng.js";
import { AnimatedGif } from "./gif.js";

/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerEngine} WorkerEngine */
/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerOutline} WorkerOutline */
/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerPlan} WorkerPlan */
/** @typedef {import("../../../api/npm/engine/index.js").Handle} Handle */
/** @typedef {import("../../../api/npm/engine/worker-engine.js").WorkerPlanOptions} PlanOptions */
/** @typedef {import("../../../api/npm/engine/index.js").WarpObject} WarpObject */
/** @typedef {"preview" | "files"} Purpose */
/** @typedef {{ q: Page.WireHandle[], strength?: number }} Frame */
/** @typedef {{ engine: WorkerEngine, plan: WorkerPlan, grid: Page.MeshGrid }} Planned */

/**
 * What the page has opened; the file stays where the browser has it.
 *
 * @typedef {{
 *   id: string,
 *   file: Blob,
 *   size: Page.Size,
 *   rest: Page.Rest,
 *   revision: number,
 *   region: Blob | null,
 *   seq: number | null,
 *   planned: Planned,
 *   replaced: Promise<unknown>,
 * }} Session
 */

/** The page opens older ones again from its own copies of the files. */
const MOST_SESSIONS = 4;
/** Where a PNG has its width and height. */
const PNG_SIZE = 16;

/** @type {Map<string, Session>} */
const sessions = new Map();
let revisions = 0;

class Refused extends Error {
  /**
   * @param {number} status
   * @param {string} code
   * @param {string} [detail]
   */
  constructor(status, code, detail = "") {
    super(detail);
    this.problem = { status, code, detail };
  }
}

// The engines

/**
 * One for previews and one for files, so that a drag never waits for a picture.
 *
 * @type {Map<Purpose, Promise<WorkerEngine>>}
 */
const engines = new Map();
/** The work under way with files. */
let works = 0;

const home = new URL("engine/", document.baseURI);

/** @param {Purpose} purpose */
async function spawned(purpose) {
  try {
    /** @type {typeof import("../../../api/npm/engine/worker-engine.js")} */
    const { WorkerEngine } = await import(new URL("worker-engine.js", home).href);
    /** @type {typeof import("../../../api/npm/engine/module.js")} */
    const { moduleOf } = await import(new URL("module.js", home).href);
    // Compiled once for both.
    return await WorkerEngine.spawn({ wasm: await moduleOf() });
  } catch (error) {
    engines.delete(purpose);
    throw new Refused(500, "no_engine", error instanceof Error ? error.message : String(error));
  }
}

/** @param {Purpose} purpose */
function engineFor(purpose) {
  const engine = engines.get(purpose) ?? spawned(purpose);
  engines.set(purpose, engine);
  return engine;
}

/** Gets both, so that the first picture does not wait for them. */
export const prepare = () =>
  Promise.all([engineFor("preview"), engineFor("files")]).catch(() => {
    // The first request that needs an engine reports the error.
  });

/**
 * Ends an engine, whatever it does; the next request starts another.
 *
 * @param {Purpose} purpose
 * @param {Promise<WorkerEngine>} ended
 */
function end(purpose, ended) {
  ended.then((engine) => engine.dispose());
  if (engines.get(purpose) === ended) engines.delete(purpose);
}

/**
 * What an engine does; one that crashes is replaced.
 *
 * @template T
 * @param {Purpose} purpose
 * @param {(engine: WorkerEngine) => Promise<T>} work
 * @returns {Promise<T>}
 */
async function by(purpose, work) {
  const promise = engineFor(purpose);
  try {
    return await work(await promise);
  } catch (error) {
    if (error instanceof Error && error.name === "EngineCrashed") end(purpose, promise);
    throw error;
  }
}

/**
 * Draws a file, and reports on it. When the request is aborted, its engine ends, because it cannot
 * stop in between.
 *
 * @param {Blob} file
 * @param {object} warp
 * @param {{ region?: Blob | null, signal?: AbortSignal | null, frame?: "gif" }} [how]
 */
async function drawn(file, warp, { region, signal, frame } = {}) {
  const [bytes, mask] = await Promise.all([file.arrayBuffer(), region?.arrayBuffer()]);
  signal?.throwIfAborted();
  const engine = engineFor("files");
  const leave = () => works === 1 && end("files", engine);
  signal?.addEventListener("abort", leave);
  works += 1;
  try {
    return await by("files", (engine) =>
      engine.warpFileWithReport(bytes, /** @type {WarpObject} */ (warp), {
        ...(mask && { region: mask }),
        ...(frame && { frame }),
      }),
    );
  } catch (error) {
    signal?.throwIfAborted();
    throw error;
  } finally {
    works -= 1;
    signal?.removeEventListener("abort", leave);
  }
}

// Sessions

/**
 * What the newest plan with an outline follows. One at a time, since it holds a picture.
 *
 * @type {{ engine: WorkerEngine, file: Blob, region: Blob | null, outline: WorkerOutline } | null}
 */
let outlined = null;

/**
 * @param {WorkerEngine} engine
 * @param {Handle[]} p
 * @param {PlanOptions} options
 * @param {Pick<Session, "file" | "region">} picture
 */
async function planInside(engine, p, options, { file, region }) {
  let own = outlined;
  if (own?.engine !== engine || own.file !== file || own.region !== region) {
    const [bytes, mask] = await Promise.all([file.arrayBuffer(), region?.arrayBuffer()]);
    const outline = await engine.outline(bytes, { ...(mask && { region: mask }) });
    outlined?.outline.dispose();
    outlined = own = { engine, file, region, outline };
  }
  // Without a wait, in which another request may dispose of it.
  return engine.plan(p, { ...options, outline: own.outline });
}

/**
 * The plan of rest handles, and its grid.
 *
 * @param {Pick<Session, "file" | "size" | "rest" | "region">} session
 * @returns {Promise<Planned>}
 */
async function planned(session) {
  const { p, output: _, ...rest } = session.rest;
  const { size } = session;
  return by("preview", async (engine) => {
    const options = /** @type {PlanOptions} */ ({ size, ...rest });
    const handles = /** @type {Handle[]} */ (p);
    const plan = isOutlined(session.rest)
      ? await planInside(engine, handles, options, session)
      : await engine.plan(handles, options);
    const pose = await plan.pose(handles);
    const { columns, rows, xy } = await pose.mesh();
    pose.dispose();
    const [width, height] = size;
    // The lines are at equal distances, but for the last one.
    const grid = { columns, rows, width, height, cell: [xy[2], xy[2 * columns + 1]] };
    return { engine, plan, grid: /** @type {Page.MeshGrid} */ (grid) };
  });
}

/**
 * Width and height of a file that the engine can read. A browser may read others, or fewer.
 *
 * @param {Blob} file
 * @param {AbortSignal | null | undefined} signal
 * @returns {Promise<Page.Size>}
 */
async function sizeOf(file, signal) {
  // First, because it refuses what is too large for memory.
  await drawn(file, { p: [], q: [], output: { width: 1 } }, { signal });
  const bitmap = await createImageBitmap(file).catch(() => null);
  if (bitmap) {
    const { width, height } = bitmap;
    bitmap.close();
    return [width, height];
  }
  const whole = (await drawn(file, { p: [], q: [] }, { signal })).file;
  const head = new DataView(whole.buffer, whole.byteOffset + PNG_SIZE, 8);
  return [head.getUint32(0), head.getUint32(4)];
}

/** @type {(id: string) => Session} */
function find(id) {
  const session = sessions.get(id);
  if (!session) throw new Refused(404, "no_such_session");
  return session;
}

/**
 * As the server describes it; handles that coincide are not named.
 *
 * @param {Session} session
 */
function described({ id, size: [width, height], rest, revision, region, seq, planned: { grid } }) {
  const { coincident: policy, grid: requested, ...others } = rest;
  const { columns, rows, cell } = grid;
  return {
    ...others,
    id,
    seq,
    image: { width, height },
    rest_revision: String(revision),
    coincident_policy: policy,
    units: "px",
    grid: { columns, rows, cell, requested },
    layers: region ? { region: {} } : {},
  };
}

/**
 * @param {string} id
 * @param {FormData} form
 * @param {AbortSignal | null | undefined} signal
 */
async function open(id, form, signal) {
  const file = /** @type {File} */ (form.get("image"));
  /** @type {Page.Rest} */
  const rest = JSON.parse(await /** @type {File} */ (form.get("warp")).text());
  const picture = { file, size: await sizeOf(file, signal), rest, region: null };
  /** @type {Session} */
  const session = {
    id,
    ...picture,
    revision: ++revisions,
    seq: null,
    planned: await planned(picture),
    replaced: Promise.resolve(),
  };
  // The same request, sent again.
  close(id);
  sessions.set(id, session);
  for (const old of [...sessions.keys()].slice(0, -MOST_SESSIONS)) close(old);
  return described(session);
}

/** @param {string} id */
function close(id) {
  sessions.get(id)?.planned.plan.dispose();
  sessions.delete(id);
}

/**
 * Replaces the handles at rest, or the region, which is a part of an outline; one after the other,
 * since a plan is of both.
 *
 * @param {Session} session
 * @param {Partial<Pick<Session, "rest" | "region">>} change
 */
function replace(session, change) {
  const replaced = session.replaced.then(async () => {
    const after = { ...session, ...change };
    if (change.rest || isOutlined(after.rest)) {
      const next = await planned(after);
      // After the wait, in which a pose may have replaced it.
      session.planned.plan.dispose();
      Object.assign(session, { planned: next, revision: ++revisions });
    }
    return described(Object.assign(session, change));
  });
  session.replaced = replaced.catch(() => {});
  return replaced;
}

/**
 * A pose by the engine: the places of its grid, and what is said of it.
 *
 * @param {Session} session
 * @param {Frame} pose
 */
function posed(session, { q, strength }) {
  return by("preview", async (engine) => {
    // That of the plan may have crashed.
    if (session.planned.engine !== engine) session.planned = await planned(session);
    const pose = await session.planned.plan.pose(/** @type {Handle[]} */ (q), strength);
    const { xy } = await pose.mesh();
    pose.dispose();
    return { xy, report: pose.report };
  });
}

/**
 * The names of `Warp-` headers.
 *
 * @param {import("../../../api/npm/engine/index.js").Report} report
 * @returns {Record<string, string>}
 */
const headersOf = ({ folds, residual, warnings }) => ({
  "Warp-Folds": String(folds),
  "Warp-Residual": String(residual),
  "Warp-Warning": warnings.map(({ code }) => code).join(", "),
});

/**
 * @param {Session} session
 * @param {Page.Pose} pose
 * @param {AbortSignal | null | undefined} signal
 */
async function picture(session, pose, signal) {
  const { rest, region, file } = session;
  const warp = { ...rest, q: pose.q, output: { ...rest.output, ...pose.output } };
  const { file: bytes, report } = await drawn(file, warp, { region, signal });
  return new Response(bytes, {
    headers: {
      ...headersOf(report),
      ...(report.canvas && { "Warp-Canvas": report.canvas }),
      "Content-Type": `image/${pose.output?.format ?? "png"}`,
    },
  });
}

/**
 * Whether images show that something is not covered; the server gives alpha to those only where
 * something is not.
 *
 * @param {Page.Rest["output"]} output
 */
const mayHaveAlpha = ({ outside, holes }) =>
  !/^(edge|reflect|#[0-9a-f]{6}(ff)?)$/i.test(String(outside)) || holes === "transparent";

/**
 * Every pose is refused before the first is drawn, or none; with the canvas that shows all of them.
 *
 * @param {Session} session
 * @param {Frame[]} frames
 * @param {AbortSignal | null | undefined} signal
 */
async function surveyed(session, frames, signal) {
  const { rest, region, file } = session;
  const { canvas } = rest.output;
  let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const frame of frames) {
    await posed(session, frame);
    signal?.throwIfAborted();
    if (canvas !== "fit") continue;
    const small = { ...rest, ...frame, output: { ...rest.output, width: 1 } };
    const { report } = await drawn(file, small, { region, signal });
    const [x, y, width, height] = known(boxFrom(report.canvas));
    [left, top] = [Math.min(left, x), Math.min(top, y)];
    [right, bottom] = [Math.max(right, x + width), Math.max(bottom, y + height)];
  }
  return canvas === "fit" ? { x: left, y: top, width: right - left, height: bottom - top } : canvas;
}

/**
 * An animation, a frame at a time.
 *
 * @param {Session} session
 * @param {{
 *   q: Page.WireHandle[], steps: number, easing: Page.Animation["easing"], frames?: Frame[],
 *   and_back?: boolean, delay: number, output?: Page.Output,
 * }} batch
 * @param {boolean} isGif
 * @param {AbortSignal | null | undefined} signal
 */
async function animation(session, { q, steps, easing, and_back, delay, ...more }, isGif, signal) {
  const inBetween = (/** @type {number} */ k) => EASINGS[easing](k / (steps - 1));
  const there =
    more.frames ?? Array.from({ length: steps }, (_, k) => ({ q, strength: inBetween(k) }));
  const frames = and_back ? [...there, ...there.slice(1, -1).reverse()] : there;
  const { file, rest, region } = session;
  const canvas = await surveyed(session, there, signal);
  /** @type {Page.Rest["output"]} */
  const output = { ...rest.output, .../** @type {{}} */ (more.output), canvas };
  const draw = (/** @type {Frame} */ frame) =>
    drawn(file, { ...rest, ...frame, output }, { region, signal, ...(isGif && { frame: "gif" }) });
  const written = isGif
    ? new AnimatedGif(delay)
    : new AnimatedPng(frames.length, delay, mayHaveAlpha(output));
  let count = 0;
  const body = new ReadableStream({
    async pull(controller) {
      if (count === frames.length) {
        controller.enqueue(await written.end());
        return controller.close();
      }
      const { file } = await draw(frames[count++]);
      for (const part of await written.frame(file)) controller.enqueue(part);
    },
  });
  return new Response(body, {
    headers: {
      "Warp-Frames": String(frames.length),
      "Content-Type": isGif ? "image/gif" : "image/apng",
    },
  });
}

/**
 * Landmark files: one with both sides, or one for each.
 *
 * @param {URLSearchParams} query
 * @param {Blob | FormData} body
 */
async function landmarks(query, body) {
  const parts = body instanceof FormData ? ["landmarks_p", "landmarks_q"] : [];
  const files = parts.length
    ? parts.map((name) => /** @type {File} */ (/** @type {FormData} */ (body).get(name)))
    : [/** @type {Blob} */ (body)];
  if (query.has("extent_p") || (body instanceof FormData && body.has("extent_p")))
    throw new Refused(422, "needs_server", "A file that counts y from below needs a server.");
  const item = query.get("item");
  const [p, q] = await Promise.all(files.map((file) => file.arrayBuffer()));
  // The engine for files ends when a picture is aborted, and would take this request with it.
  return by("preview", (engine) => engine.landmarks(p, q, item === null ? {} : { item }));
}

// Requests

/** @type {(value: unknown) => Response} */
const json = (value) => Response.json(value);

/**
 * @param {URL} url
 * @param {RequestInit} request
 * @returns {Promise<Response>}
 */
async function routed({ pathname, searchParams }, { method = "GET", body, signal, headers }) {
  const [kind, id = "", ...rest] = pathname.slice(1).split("/").map(decodeURIComponent);
  const value = () => JSON.parse(/** @type {string} */ (body));
  switch ([method, kind, ...rest].join(" ")) {
    case "POST landmarks":
      return json(await landmarks(searchParams, /** @type {Blob | FormData} */ (body)));
    case "PUT sessions":
      return json(await open(id, /** @type {FormData} */ (body), signal));
    case "GET sessions":
      return json(described(find(id)));
    case "DELETE sessions":
      close(id);
      return json(null);
    case "PUT sessions handles":
      return json(await replace(find(id), { rest: value() }));
    case "PUT sessions layers region":
      return json(await replace(find(id), { region: /** @type {Blob} */ (body) }));
    case "GET sessions layers region":
      return new Response(find(id).region);
    case "DELETE sessions layers region":
      return json(await replace(find(id), { region: null }));
    case "POST sessions mesh": {
      const { xy, report } = await posed(find(id), value());
      return new Response(xy, { headers: headersOf(report) });
    }
    case "POST sessions warp":
      return picture(find(id), value(), signal);
    case "POST sessions batch":
      const wanted = new Headers(headers).get("Accept");
      if (wanted === "application/zip")
        throw new Refused(406, "needs_server", "Choose an animated PNG or GIF.");
      return animation(find(id), value(), wanted === "image/gif", signal);
    default:
      throw new Refused(404, "needs_server");
  }
}

/**
 * As `fetch`.
 *
 * @param {string} path
 * @param {RequestInit} request
 */
export async function answer(path, request) {
  try {
    return await routed(new URL(path, "http://engine/"), request);
  } catch (error) {
    if (!(error instanceof Error) || error.name === "AbortError") throw error;
    const { status = 500, ...problem } = /** @type {any} */ (error).problem ?? {
      code: "internal",
      detail: error.message,
    };
    return Response.json({ ...problem, status }, { status });
  }
}
