// Files with handles: the warp object as JSON, read here, and landmark files of other programs,
// which the server reads. A file that cannot be used is rejected with its name, the position and
// what is expected.

import { CLASSES } from "./align.js";
import { Problem } from "./api.js";
import { infoOf, massOf, near, takesLinesOnly, takesPinsOnly } from "./edits.js";
import { METHODS } from "./methods.js";
import { Broken, lineAndColumn, parse } from "./json.js";
import { landmarksOf, sidesOf } from "./landmarks.js";
import { decodeParts } from "./region.js";
import { pinOf } from "./twist.js";

/** Largest file, bytes: many times what this page writes, with the mask of a large picture. */
const LARGEST = 16 << 20;
const METRICS = ["euclidean", "geodesic"];
const FILTERS = ["nearest", "bilinear", "bicubic"];

/**
 * The handles of a file: { name, document, warp, missing: how many have no position }. The
 * positions of a normalised file are shares of the picture's size; `warp` then makes the document
 * for a picture (`scaled`), and is otherwise null. Throws a Problem, or as `landmarksOf`.
 * @param {File} file
 * @param {import("./landmarks.js").OfPicture | null} picture
 * @returns {Promise<Page.HandlesFile>}
 */
export async function readHandles(file, picture) {
  /** @type {(detail: string) => Problem} */
  const problem = (detail) => new Problem({ code: "bad_handles_file", detail }, 0);
  if (file.size > LARGEST)
    throw problem(`The file ${file.name} is too large for a file of handles.`);
  const text = await file.text();
  /** @type {(at: number) => string} */
  const where = (at) => {
    const { line, column } = lineAndColumn(text, at);
    return `In ${file.name}, line ${line}, column ${column}`;
  };
  /** @type {(warp: Page.Json, isLandmarks?: boolean) => Page.HandlesFile} */
  const ready = (warp, isLandmarks = false) => {
    const isNormalized = warp?.units === "normalized";
    const document = documentFrom(isNormalized ? { ...warp, units: "px" } : warp);
    const missing = warp.p.length - document.handles.length;
    return { name: file.name, document, warp: isNormalized ? warp : null, missing, isLandmarks };
  };
  /** @type {ReturnType<typeof parse> | null} */
  let parsed = null;
  try {
    if (/^\s*($|[{[])/.test(text) && !isTable(file)) parsed = parse(text);
    if (!parsed || (parsed.value?.p === undefined && Object.keys(parsed.value).length))
      return ready(await landmarks(file, picture), true);
    const read = ready(parsed.value);
    await decodeParts(read.document.region ?? []).catch(() =>
      demand(false, "/region", "the mask of a region, a PNG in base64,"),
    );
    return read;
  } catch (error) {
    if (error instanceof Broken)
      throw problem(`${where(error.at)}: ${error.expected} is expected.`);
    if (!(error instanceof Unsupported)) throw error;
    const member = error.pointer && ` for ${named(error.pointer)}`;
    throw problem(
      `${where(parsed?.places.get(error.pointer) ?? 0)}: ${error.expected} is expected${member}.`,
    );
  }
}

/** @type {(file: File) => boolean} */
const isTable = (file) =>
  file.type === "text/csv" || /\.(csv|tsv|pts|tem|tps|points|txt|xml|fcsv)$/i.test(file.name);

/**
 * The handles of two landmark files: rest and pose.
 * @param {File[]} files
 * @param {import("./landmarks.js").OfPicture | null} picture
 * @returns {Promise<Page.HandlesFile>}
 */
export async function readBoth(files, picture) {
  const names = files.map(({ name }) => name);
  try {
    const sides = await Promise.all(files.map(sideOf));
    const { p, q, units } = await sidesOf(files, sides, picture);
    const isNormalized = units === "normalized";
    const document = { ...documentFrom({ p, q }), sides: names };
    return {
      name: names.join(" and "),
      document,
      warp: isNormalized ? { p, q, units, sides: names } : null,
      missing: p.length - document.handles.length,
      isLandmarks: true,
    };
  } catch (error) {
    if (error instanceof Problem) {
      /** @type {(text: string, k: number) => string} */
      const named = (text, k) =>
        text
          .replace(new RegExp(`^landmarks_${"pq"[k]}, `), `In ${names[k]}, `)
          .replaceAll(new RegExp(`\`?landmarks_${"pq"[k]}\`?`, "g"), names[k]);
      error.detail = named(named(error.detail, 0), 1);
    }
    throw error;
  }
}

/**
 * A file as one side: of a warp object without q, the handles alone.
 * @param {File} file
 * @returns {Promise<Blob>}
 */
async function sideOf(file) {
  if (isTable(file) || file.size > LARGEST) return file;
  try {
    const { p, names, units } = JSON.parse(await file.text());
    return p === undefined ? file : new Blob([JSON.stringify({ p, names, units })]);
  } catch {
    return file;
  }
}

/**
 * A landmark file as a warp object.
 * @param {File} file
 * @param {import("./landmarks.js").OfPicture | null} picture
 * @returns {Promise<Page.Landmarks>}
 */
async function landmarks(file, picture) {
  const { p, q, units } = await landmarksOf(file, picture);
  return { p, ...(q && { q }), units };
}

/**
 * The document of a normalised warp object for a picture.
 * @param {Page.Json} warp
 * @param {{ width: number, height: number }} size
 * @returns {Page.Document}
 */
export function scaled({ p, q, sides, ...others }, { width, height }) {
  /** @type {(place: Page.Place) => Page.Place} */
  const place = ([x, y]) => [x * width, y * height];
  /** @type {(handles: Page.Json[]) => Page.Json[]} */
  const px = (handles) =>
    handles.map((handle) => (isPlace(handle) ? place(handle) : (handle?.map(place) ?? null)));
  return {
    ...documentFrom({ ...others, p: px(p), ...(q && { q: px(q) }), units: "px" }),
    ...(sides && { sides }),
  };
}

/**
 * A pointer as in the API's messages: `p[3]`.
 * @type {(pointer: string) => string}
 */
export const named = (pointer) =>
  pointer
    .slice(1)
    .replace(/\/(\d+)/g, "[$1]")
    .replaceAll("/", ".");

/** A warp object that this page does not support: the first value at fault. */
export class Unsupported extends Error {
  /**
   * @param {string} pointer
   * @param {string} expected
   */
  constructor(pointer, expected) {
    super(`${pointer}: ${expected}`);
    this.pointer = pointer;
    this.expected = expected;
  }
}

/** @type {(holds: unknown, pointer: string, expected: string) => asserts holds} */
export const demand = (holds, pointer, expected) => {
  if (!holds) throw new Unsupported(pointer, expected);
};

/**
 * The document of a warp object; `null` if this page does not support it.
 * @param {Page.Json} warp
 * @returns {Page.Document | null}
 */
export function documentOf(warp) {
  try {
    return documentFrom(warp);
  } catch (error) {
    if (error instanceof Unsupported) return null;
    throw error;
  }
}

/** @type {(value: unknown) => value is Page.Place} */
export const isPlace = (value) =>
  Array.isArray(value) && value.length === 2 && value.every(Number.isFinite);

/**
 * The positions of a handle: [x, y] is a point, a list of positions is a line or a path.
 * @param {Page.Json} handle
 * @param {string} pointer
 * @returns {Page.Place[]}
 */
function placesOf(handle, pointer) {
  if (isPlace(handle)) return [handle];
  demand(
    Array.isArray(handle) && Array.isArray(handle[0]),
    pointer,
    "a position [x, y] or a list of positions",
  );
  const wrong = handle.findIndex((place) => !isPlace(place));
  demand(wrong < 0, `${pointer}/${wrong}`, "a position [x, y] of two numbers");
  return handle;
}

/**
 * @param {Page.Json} warp
 * @returns {Page.Document}
 */
export function documentFrom(warp) {
  const isObject = warp !== null && typeof warp === "object" && !Array.isArray(warp);
  demand(
    isObject && warp.p !== undefined,
    "",
    'an object with the handles at rest, {"p": [[x, y], ...], "q": [...]},',
  );
  const given = Object.fromEntries(Object.entries(warp).filter(([, value]) => value !== null));
  const {
    p,
    q = p,
    weights,
    depth,
    point_mass: mass,
    units = "px",
    method = "rigid",
    alpha = null,
    smoothing,
    metric = "euclidean",
    mask: inside,
    coincident,
    grid = "auto",
    folds,
  } = given;
  demand(Array.isArray(p), "/p", "a list of handles");
  demand(
    Array.isArray(q) && q.length === p.length,
    "/q",
    `a list of ${p.length} handles, as many as in p,`,
  );
  // A handle without a position on either side is left out, as the server does.
  const present = [...p.keys()].filter((i) => p[i] !== null && q[i] !== null);
  demand(units === "px", "/units", '"px" or "normalized"');
  /** @type {(list: Page.Json) => boolean} */
  const areWeights = (list) =>
    Array.isArray(list) && list.length === p.length && list.every((w) => w > 0);
  demand(
    weights === undefined || areWeights(weights),
    "/weights",
    "a list of one positive number for each handle",
  );
  demand(
    depth === undefined ||
      (Array.isArray(depth) &&
        depth.length === p.length &&
        depth.every((d) => Number.isFinite(d) && Math.abs(d) <= 1000)),
    "/depth",
    "a list of one number between -1000 and 1000 for each handle",
  );
  demand(mass === undefined || mass > 0, "/point_mass", "a positive number");
  /** @type {Page.Handle[]} */
  const handles = present.map((i, n) => {
    const [rest, posed] = [placesOf(p[i], `/p/${i}`), placesOf(q[i], `/q/${i}`)];
    demand(
      posed.length === rest.length,
      `/q/${i}`,
      `a handle of ${rest.length} ${rest.length === 1 ? "position" : "positions"}, as in p,`,
    );
    const pin = pinOf(rest, posed, weights?.[i], mass);
    return {
      id: n + 1,
      ...(pin ?? { p: rest, q: posed, ...(weights && { weight: weights[i] }) }),
      ...(depth?.[i] && { depth: depth[i] }),
    };
  });
  // Weights of 1 are only the companions of those of twisted pins.
  if (handles.every((h) => h.twist || h.weight === 1))
    for (const handle of handles) delete handle.weight;
  demand(
    CLASSES.includes(given.align ?? "none"),
    "/align",
    '"none", "rigid", "similarity" or "affine"',
  );
  demand(
    METHODS.some(({ name }) => name === method),
    "/method",
    `one of ${METHODS.map(({ name }) => `"${name}"`).join(", ")}`,
  );
  const line = takesPinsOnly({ method }) ? handles.findIndex((h) => h.p.length > 1 || h.twist) : -1;
  demand(
    line < 0,
    `/p/${present[line]}`,
    `a position [x, y], because the method "${method}" takes points only on this page,`,
  );
  const point = takesLinesOnly({ method }) ? handles.findIndex((h) => h.p.length < 2) : -1;
  demand(
    point < 0,
    `/p/${present[point]}`,
    `a line [[x, y], [x, y]], because the method "${method}" takes lines only,`,
  );
  const { object, parameters } = infoOf({ method });
  const own = object ? given[method] : undefined;
  const names = parameters.map(({ name }) => name);
  demand(
    own === undefined ||
      (own !== null &&
        typeof own === "object" &&
        Object.entries(own).every(([name, value]) => names.includes(name) && value >= 0)),
    `/${method}`,
    `an object with the numbers ${names.join(", ")}`,
  );
  demand(METRICS.includes(metric), "/metric", '"euclidean" or "geodesic"');
  const threshold = inside?.threshold;
  demand(
    inside === undefined || threshold === undefined || (threshold >= 0 && threshold <= 1),
    "/mask/threshold",
    "a number between 0 and 1",
  );
  demand(smoothing === undefined || smoothing >= 0, "/smoothing", "a number, at least 0,");
  const { policy = "mean", within = 0 } = coincident ?? {};
  demand(policy === "mean" || policy === "reject", "/coincident/policy", '"mean" or "reject"');
  demand(
    within >= 0 && within <= 1_000_000,
    "/coincident/within",
    "a distance in px, 0 to 1000000,",
  );
  demand(alpha === null || Number.isFinite(alpha), "/alpha", "a number");
  const isTolerance = grid?.tolerance >= 0.05 && grid.tolerance <= 4;
  const cell = grid === "auto" || isTolerance ? grid : grid?.cell;
  demand(
    cell === "auto" || isTolerance || cell > 0,
    "/grid",
    '"auto", {"tolerance": px} between 0.05 and 4, or {"cell": px}',
  );
  const outside = outsideFrom(given.output?.outside ?? "transparent");
  demand(
    outside !== null,
    "/output/outside",
    '"transparent", "edge", "reflect", a colour "#rrggbbaa" or {"value": number or [r, g, b]}',
  );
  const filter = given.output?.filter ?? "bilinear";
  demand(FILTERS.includes(filter), "/output/filter", '"nearest", "bilinear" or "bicubic"');
  const holes = given.output?.holes ?? null;
  demand(
    holes === null || holes === "keep" || holes === "transparent",
    "/output/holes",
    '"keep" or "transparent"',
  );
  const canvas = given.output?.canvas ?? "same";
  demand(
    isCanvas(canvas),
    "/output/canvas",
    '"same", "fit" or {"x", "y", "width", "height"} in whole px',
  );
  const mask = given.region;
  demand(
    mask === undefined || (typeof mask === "string" && /^[A-Za-z0-9+/]+={0,2}$/.test(mask)),
    "/region",
    "the mask of a region, a PNG in base64,",
  );
  // What is in the mask is feathered already.
  const region =
    mask === undefined
      ? {}
      : { region: [{ kind: "mask", png: mask }], feather: 0, holes: holes ?? "keep" };
  // Until it is aligned (align.js), its handles are where the file has them.
  const align = (given.align ?? "none") === "none" ? {} : { align: { by: given.align, handles } };
  const read = {
    holes,
    ...region,
    ...align,
    handles,
    method,
    alpha,
    ...(smoothing && { smoothing }),
    ...(own && { own: { [method]: own } }),
    metric,
    ...(threshold !== undefined && { threshold }),
    ...((policy !== "mean" || within) && { coincident: { policy, within } }),
    ...(folds === "remove" && { folds }),
    grid: cell,
    outside,
    filter,
    canvas,
  };
  // A mass that the page would choose itself continues to follow the lines.
  const usual = massOf(read);
  const follows =
    mass === undefined ||
    (usual !== undefined && near(mass, usual)) ||
    handles.every((h) => h.p.length === 1);
  return follows ? read : { ...read, mass };
}

/** @param {Page.Json} canvas */
function isCanvas(canvas) {
  if (canvas === "same" || canvas === "fit") return true;
  const { x, y, width, height } = canvas;
  return (
    [x, y, width, height].every(Number.isInteger) &&
    Math.max(Math.abs(x), Math.abs(y)) <= 1_000_000 &&
    width >= 1 &&
    height >= 1
  );
}

/**
 * The server's form of what is outside, or null.
 * @param {Page.Json} told
 * @returns {Page.Outside | null}
 */
function outsideFrom(told) {
  if (typeof told === "object" && told !== null) return valueFrom(told);
  if (told === "transparent" || told === "edge" || told === "reflect") return told;
  const [, colour, alpha = "ff"] =
    /^(#[0-9a-f]{6})([0-9a-f]{2})?$/.exec(String(told).toLowerCase()) ?? [];
  return colour ? colour + alpha : null;
}

/**
 * A value in units of the picture's depth: one number if its colours are equal; or null.
 * @param {Page.Json} told
 * @returns {Page.OutsideValue | null}
 */
function valueFrom({ value, ...others }) {
  const samples = [value].flat();
  const isOne = samples.length === 1 && !Array.isArray(value);
  /** @type {(sample: Page.Json) => boolean} */
  const isSample = (sample) => Number.isInteger(sample) && sample >= 0 && sample <= 65535;
  if (Object.keys(others).length || (!isOne && samples.length !== 3) || !samples.every(isSample))
    return null;
  return { value: samples.every((sample) => sample === samples[0]) ? samples[0] : samples };
}
