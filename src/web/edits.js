// Edits of a document: pure functions that return a new document, or the same one if nothing
// changes. Positions are [x, y] in picture px, rounded to 0.01, so that the table shows the values
// that are sent.

import { canvasOf } from "./canvas.js";
import { METHODS } from "./methods.js";
import { regionOf } from "./region.js";
import { LEAST_ALPHA, segmentOf, segmentWeight, turned, untwisted } from "./twist.js";

/** @type {(handle: Pick<Page.Handle, "p">) => Page.HandleKind} */
export const kindOf = ({ p }) => (p.length === 1 ? "point" : p.length === 2 ? "line" : "path");
/** @type {(handle: Page.Handle) => string} */
export const kindName = (handle) =>
  ({ point: "Point", line: "Line", path: "Path" })[kindOf(handle)];

/** @type {(tool: Page.Tool) => string} */
export const toolName = (tool) =>
  ({ point: "Point", line: "Line", path: "Path", lasso: "Lasso", brush: "Brush" })[tool];

/** @typedef {"transparent" | "edge" | "reflect" | "colour" | "value"} OutsideKind */

/** What is without a meaning for a pin that is twisted already. */
const UNTURNED = { angle: 0, scale: 1 };
/** The server's limit of a depth. */
const DEEPEST = 1000;
/** The server's limit of a coordinate. */
const REACH = 1e6;
/** @type {(x: number) => number} */
const round = (x) => Math.min(REACH, Math.max(-REACH, Math.round(x * 100) / 100)) + 0;
/** @type {(place: Page.Place) => Page.Place} */
export const rounded = ([x, y]) => [round(x), round(y)];

/** @type {(a: Page.Place, b: Page.Place) => boolean} */
const same = (a, b) => a[0] === b[0] && a[1] === b[1];
/** @type {(key: string) => number} */
const idOf = (key) => Number(key.split(".")[0]);
/** @type {(key: string) => number | null} */
const vertexOf = (key) => (key.includes(".") ? Number(key.split(".")[1]) : null);

/**
 * The selected vertices: Map of handle id to vertex indices. Vertices of one handle that coincide
 * at rest are selected together.
 * @param {Page.Document} document
 * @param {string[]} selection
 * @returns {Map<number, Set<number>>}
 */
export function placesOf(document, selection) {
  /** @type {Map<number, Set<number>>} */
  const found = new Map();
  for (const key of selection) {
    const handle = document.handles.find((h) => h.id === idOf(key));
    if (!handle) continue;
    const places = found.get(handle.id) ?? new Set();
    const vertex = vertexOf(key);
    handle.p.forEach((p, k) => {
      if (vertex === null || same(p, handle.p[vertex])) places.add(k);
    });
    found.set(handle.id, places);
  }
  return found;
}

/**
 * Posed positions of a selection.
 * @param {Page.Document} document
 * @param {string[]} selection
 */
export function posedPlaces(document, selection) {
  const places = placesOf(document, selection);
  return document.handles.flatMap((h) => [...(places.get(h.id) ?? [])].map((k) => h.q[k]));
}

/**
 * Maps every posed position of a selection by `to`.
 * @param {Page.Document} document
 * @param {string[]} selection
 * @param {(place: Page.Place) => Page.Place} to
 * @returns {Page.Document}
 */
export function moved(document, selection, to) {
  const places = placesOf(document, selection);
  let changed = false;
  const handles = document.handles.map((handle) => {
    const mine = places.get(handle.id);
    if (!mine) return handle;
    const q = handle.q.map((place, k) => (mine.has(k) ? rounded(to(place)) : place));
    if (q.every((place, k) => same(place, handle.q[k]))) return handle;
    changed = true;
    return { ...handle, q };
  });
  return changed ? { ...document, handles } : document;
}

/**
 * @type {(document: Page.Document, selection: string[], dx: number, dy: number) => Page.Document}
 */
export const translated = (document, selection, dx, dy) =>
  moved(document, selection, ([x, y]) => [x + dx, y + dy]);

/**
 * @param {Page.Document} document
 * @param {string[]} selection
 * @param {Page.Place} centre
 * @param {number} angle radians
 * @returns {Page.Document}
 * @param {Page.Size} size of the picture
 */
export function rotated(document, selection, [cx, cy], angle, size) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const next = moved(document, selection, ([x, y]) => [
    cx + (x - cx) * cos - (y - cy) * sin,
    cy + (x - cx) * sin + (y - cy) * cos,
  ]);
  // Twisted pins turn with their surroundings.
  /** @type {(handle: Page.Handle) => boolean} */
  const turns = (handle) => Boolean(handle.twist) && selection.includes(String(handle.id));
  if (!next.handles.some(turns)) return next;
  /** @type {(handle: Page.Handle) => Page.Handle} */
  const turn = (handle) =>
    handle.twist && turns(handle)
      ? turned(handle, handle.twist.angle + (angle * 180) / Math.PI, UNTURNED, size)
      : handle;
  return { ...next, handles: next.handles.map(turn) };
}

/**
 * Centre and radius of the circle around positions.
 * @param {Page.Place[]} places
 * @returns {Page.Circle}
 */
export function circleOf(places) {
  const xs = places.map((p) => p[0]);
  const ys = places.map((p) => p[1]);
  /** @type {Page.Place} */
  const centre = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  return {
    centre,
    radius: Math.max(...places.map((p) => Math.hypot(p[0] - centre[0], p[1] - centre[1]))),
  };
}

/**
 * @param {Page.Document} document
 * @param {string[]} selection
 * @returns {Page.Document}
 */
export function putBack(document, selection) {
  const places = placesOf(document, selection);
  let changed = false;
  const handles = document.handles.map((handle) => {
    const mine = places.get(handle.id);
    if (!mine || (!handle.twist && [...mine].every((k) => same(handle.p[k], handle.q[k]))))
      return handle;
    changed = true;
    return {
      ...untwisted(handle),
      q: handle.q.map((place, k) => (mine.has(k) ? handle.p[k] : place)),
    };
  });
  return changed ? { ...document, handles } : document;
}

/**
 * Removes whole handles, and vertices of paths while two remain.
 * @param {Page.Document} document
 * @param {string[]} selection
 * @returns {Page.Document}
 */
export function removed(document, selection) {
  const handles = document.handles.flatMap((handle) => {
    const keys = selection.filter((key) => idOf(key) === handle.id);
    if (!keys.length) return [handle];
    const gone = new Set(keys.map(vertexOf));
    /** @type {(_: unknown, k: number) => boolean} */
    const stays = (_, k) => !gone.has(k);
    const p = handle.p.filter(stays);
    if (gone.has(null) || p.length < 2 || !segmentsHaveLength(p)) return [];
    return [{ ...handle, p, q: handle.q.filter(stays) }];
  });
  return handles.length === document.handles.length &&
    handles.every((h, i) => h === document.handles[i])
    ? document
    : { ...document, handles };
}

/** @type {(p: Page.Place[]) => boolean} */
const segmentsHaveLength = (p) => p.every((place, k) => k === 0 || !same(place, p[k - 1]));

/**
 * Adds a handle; `null` if all of its segments would have zero length at rest. Repeated positions
 * are dropped.
 * @param {Page.Document} document
 * @param {Page.Place[]} p
 * @param {Page.Place[]} q
 */
export function added(document, p, q) {
  const rest = p.map(rounded);
  const keep = rest.map((place, k) => k === 0 || !same(place, rest[k - 1]));
  const id = 1 + Math.max(0, ...document.handles.map((h) => h.id));
  const handle = {
    id,
    p: rest.filter((_, k) => keep[k]),
    q: q.map(rounded).filter((_, k) => keep[k]),
  };
  if (p.length > 1 && handle.p.length < 2) return null;
  return { document: { ...document, handles: [...document.handles, handle] }, key: String(id) };
}

/**
 * Sets one coordinate of the table.
 * @param {Page.Document} document
 * @param {Page.Which} which
 * @param {number} index
 * @param {number} vertex
 * @param {number} axis
 * @param {number} value
 * @returns {Page.Document}
 */
export function withNumber(document, which, index, vertex, axis, value) {
  const old = document.handles[index];
  const places = old[which].map((place, k) =>
    k === vertex ? place.map((c, way) => (way === axis ? round(value) : c)) : place,
  );
  if (same(places[vertex], old[which][vertex])) return document;
  const handles = document.handles.with(index, { ...old, [which]: places });
  return { ...document, handles };
}

/**
 * A closed path around the picture.
 * @param {number} width
 * @param {number} height
 * @returns {Page.Place[]}
 */
export function borderPath(width, height) {
  return [
    [0, 0],
    [width, 0],
    [width, height],
    [0, height],
    [0, 0],
  ];
}

/**
 * Turns a pin to an angle, in degrees; `free`: its angle and scale without a twist. An angle of
 * null removes the twist.
 * @param {Page.Document} document
 * @param {number} index
 * @param {number | null} degrees
 * @param {Page.Turn} free
 * @param {Page.Size} size
 * @returns {Page.Document}
 */
export function withTwist(document, index, degrees, free, size) {
  const old = document.handles[index];
  const next =
    degrees !== null ? turned(old, degrees, free, size) : old.twist ? untwisted(old) : old;
  return next === old ? document : { ...document, handles: document.handles.with(index, next) };
}

/** @type {(handle: Page.Handle) => number} */
export const depthOf = ({ depth }) => depth ?? 0;

/**
 * A handle with a depth, within the server's limits; 0 is no depth.
 * @type {(handle: Page.Handle, depth: number) => Page.Handle}
 */
function atDepth({ depth: _, ...handle }, depth) {
  const value = Math.min(DEEPEST, Math.max(-DEEPEST, depth)) + 0;
  return value ? { ...handle, depth: value } : handle;
}

/**
 * Sets the depth of a handle.
 * @param {Page.Document} document
 * @param {number} index
 * @param {number} depth
 * @returns {Page.Document}
 */
export function withDepth(document, index, depth) {
  const old = document.handles[index];
  const next = atDepth(old, depth);
  if (depthOf(next) === depthOf(old)) return document;
  return { ...document, handles: document.handles.with(index, next) };
}

/**
 * Puts the selected handles in front of all others, or behind them.
 * @param {Page.Document} document
 * @param {string[]} selection
 * @param {boolean} isFront
 * @returns {Page.Document}
 */
export function brought(document, selection, isFront) {
  const chosen = new Set(selection.map(idOf));
  const way = isFront ? 1 : -1;
  /** @type {(of: boolean) => number[]} */
  const depths = (of) =>
    document.handles.filter((h) => chosen.has(h.id) === of).map((h) => way * depthOf(h));
  const [mine, others] = [depths(true), depths(false)];
  const farthest = Math.max(...others);
  if (!mine.length || !others.length || Math.min(...mine) > farthest) return document;
  const next = Math.floor(farthest) + 1;
  // Only who brings a thousand handles to the front one after the other gets here.
  const levels = next > DEEPEST ? [...new Set(others)].sort((a, b) => a - b) : null;
  /** @type {(handle: Page.Handle) => Page.Handle} */
  const moved = (h) => {
    if (chosen.has(h.id)) return atDepth(h, way * (levels ? levels.length : next));
    return levels ? atDepth(h, way * levels.indexOf(way * depthOf(h))) : h;
  };
  return { ...document, handles: document.handles.map(moved) };
}

/**
 * Whether the picture follows its outline: parts of it that are dragged come to the front.
 * @type {(document: Pick<Page.Document, "method" | "metric">) => boolean}
 */
export const isOutlined = (document) =>
  metricOf(document) === "geodesic" || Boolean(infoOf(document).mesh);

/** @type {(handle: Page.Handle) => handle is Page.Handle & { twist: Page.Twist }} */
const isPinTwisted = (handle) => handle.twist !== undefined;

/**
 * Handles in the server's form, p or q: a point is [x, y], a line is a list of positions, a twisted
 * pin is a short segment.
 * @type {(document: { handles: Page.Handle[] }, which: Page.Which) => Page.WireHandle[]}
 */
export const wire = (document, which) =>
  document.handles.map((h) =>
    isPinTwisted(h) ? segmentOf(h, which) : h[which].length === 1 ? h[which][0] : h[which],
  );

/**
 * Handles of the groups of coincident points whose displacements differ by more than a hundredth of
 * a pixel.
 * @param {Page.Document} document
 * @param {{ handles: number[] }[]} groups
 */
export function movedApart({ handles }, groups) {
  /** @type {(handle: Page.Handle) => Page.Place} */
  const moved = ({ p: [[x, y]], q: [[a, b]] }) => [a - x, b - y];
  /** @type {(moves: Page.Place[]) => boolean} */
  const differ = ([first, ...others]) =>
    others.some(([x, y]) => Math.hypot(x - first[0], y - first[1]) > 0.01);
  return groups.flatMap((group) =>
    differ(group.handles.map((index) => moved(handles[index]))) ? group.handles : [],
  );
}

/**
 * The mass of a point, px, if the set has segments; the server's default is the mean length of the
 * segments.
 * @param {Pick<Page.Document, "handles" | "mass">} document
 * @returns {number | undefined}
 */
export function massOf({ handles, mass }) {
  if (mass !== undefined) return mass;
  const lengths = handles.flatMap((h) =>
    h.p.slice(1).map((place, k) => Math.hypot(place[0] - h.p[k][0], place[1] - h.p[k][1])),
  );
  if (lengths.length) return lengths.reduce((sum, length) => sum + length, 0) / lengths.length;
  return handles.some((h) => h.twist) ? 1 : undefined;
}

/** @type {(a: number, b: number) => boolean} */
export const near = (a, b) => Math.abs(a - b) <= 1e-6 * Math.abs(b);
/** @type {(document: Page.Document) => boolean} */
const isTwisted = ({ handles }) => handles.some((h) => h.twist);
/**
 * What the server says of a method.
 * @type {(document: Pick<Page.Document, "method">) => Page.MethodInfo}
 */
export const infoOf = ({ method }) => METHODS.find(({ name }) => name === method) ?? METHODS[0];
/**
 * Whether a method has a parameter.
 * @type {(document: Pick<Page.Document, "method">, parameter: string) => boolean}
 */
const has = (document, parameter) =>
  infoOf(document).parameters.some(({ name }) => name === parameter);
/** @type {(document: Pick<Page.Document, "method">) => boolean} */
export const hasFocus = (document) => has(document, "alpha");
/**
 * Whether the handles of a method are pins. On this page, those without a focus have no lines unless
 * they take nothing else.
 * @type {(document: Pick<Page.Document, "method">) => boolean}
 */
export const takesPinsOnly = (document) =>
  infoOf(document).handles === "points" ||
  (infoOf(document).handles === "all" && !hasFocus(document));
/** @type {(document: Pick<Page.Document, "method">) => boolean} */
export const takesLinesOnly = (document) => infoOf(document).handles === "lines";
/**
 * Whether handles may have a method.
 * @type {(document: Page.Document, method: Page.Method) => boolean}
 */
export const mayHave = (document, method) =>
  (!takesPinsOnly({ method }) || hasPinsOnly(document)) &&
  (!takesLinesOnly({ method }) || document.handles.every((h) => h.p.length > 1));
/**
 * Whether all handles are pins without a twist.
 * @type {(document: Page.Document) => boolean}
 */
export const hasPinsOnly = ({ handles }) => handles.every((h) => h.p.length === 1 && !h.twist);
/** @type {(document: Page.Document) => boolean} */
export const mayTwist = (document) => hasFocus(document) && alphaOf(document) >= LEAST_ALPHA;

/**
 * How distances are measured. Methods without a focus measure none.
 * @type {(document: Pick<Page.Document, "method" | "metric">) => Page.Metric}
 */
export const metricOf = (document) =>
  (hasFocus(document) ? document.metric : undefined) ?? "euclidean";
/**
 * Whether folds can be removed: by methods that take handles to their targets in the plane.
 * @type {(document: Page.Document) => boolean}
 */
export const canUnfold = (document) =>
  metricOf(document) === "euclidean" &&
  (hasFocus(document) || (has(document, "smoothing") && !document.smoothing));
/**
 * What becomes of folds. A session keeps what it is not told.
 * @type {(document: Page.Document) => Page.Rest["folds"]}
 */
const foldsOf = (document) =>
  document.folds === "remove" && canUnfold(document) ? "remove" : "report";
/** The share of full alpha above which a pixel belongs to the inside, if none is chosen. */
const THRESHOLD = 0.5;
/** @type {(document: Page.Document) => number} */
export const thresholdOf = ({ threshold }) => threshold ?? THRESHOLD;

/**
 * Alpha; the server's default is 2 with any line and inside an outline, otherwise 1.
 * @type {(document: Pick<Page.Document, "alpha" | "handles" | "method" | "metric">) => number}
 */
export const alphaOf = (document) =>
  document.alpha ??
  (document.handles.some((h) => h.p.length > 1) || metricOf(document) === "geodesic" ? 2 : 1);

/**
 * `after`, with the focus of `before` if another automatic one would move handles that are posed.
 * @param {Page.Document} before
 * @param {Page.Document} after
 * @returns {Page.Document}
 */
export function keepingFocus(before, after) {
  if (after.alpha !== null || alphaOf(before) === alphaOf(after)) return after;
  /** @type {(handle: Page.Handle) => boolean} */
  const isPosed = (h) => Boolean(h.twist) || h.p.some((place, k) => !same(place, h.q[k]));
  return after.handles.some((h) => before.handles.includes(h) && isPosed(h))
    ? { ...after, alpha: alphaOf(before) }
    : after;
}

/**
 * The content outside the warped picture: `transparent`, `edge`, `reflect`, `#rrggbbaa` or a value
 * of the picture's depth, `{ value }`. Documents of older pages lack it.
 * @type {(document: Page.Document) => Page.Outside}
 */
export const outsideOf = ({ outside }) => outside ?? "transparent";

/**
 * The kind of content outside: a name, `colour` or `value`.
 * @type {(outside: Page.Outside) => OutsideKind}
 */
export const kindOfOutside = (outside) =>
  typeof outside === "object"
    ? "value"
    : /** @type {OutsideKind} */ (outside.startsWith("#") ? "colour" : outside);

/**
 * How the source is read: `nearest`, `bilinear` or `bicubic`. Documents of older pages lack it.
 * @type {(document: Page.Document) => Page.Filter}
 */
export const filterOf = ({ filter }) => filter ?? "bilinear";

/**
 * What is seen where the content of the region has moved away: `keep` (the picture) or
 * `transparent`.
 * @type {(document: Page.Document) => Page.Holes}
 */
export const holesOf = ({ holes }) => holes ?? "keep";

/**
 * What happens to coincident handles by default: they follow the mean of their targets.
 * @type {NonNullable<Page.Document["coincident"]>}
 */
const MEAN = { policy: "mean", within: 0 };

/**
 * The session's part of a warp object. The parameters of the method and of the output are always
 * included: an absent field keeps the session's value.
 * @param {Page.Document} document
 * @returns {Page.Rest}
 */
export function restOf(document) {
  const { handles, method, grid } = document;
  const mass = massOf(document);
  /** @type {(handle: Page.Handle) => number} */
  const weight = (h) => (isPinTwisted(h) ? segmentWeight(h, mass ?? 1) : (h.weight ?? 1));
  const weights = handles.some((h) => h.weight !== undefined || h.twist)
    ? { weights: handles.map(weight) }
    : {};
  const point_mass = mass === undefined ? {} : { point_mass: mass };
  const depth = handles.some(depthOf) ? { depth: handles.map(depthOf) } : {};
  const parameters = {
    ...(has(document, "smoothing") && { smoothing: document.smoothing ?? 0 }),
    ...(hasFocus(document) && { alpha: alphaOf(document), ...point_mass }),
    ...ownOf(document),
    ...metricIn(document),
  };
  // Without a region there are no holes.
  const holes = regionOf(document).parts.length ? { holes: holesOf(document) } : {};
  const output = {
    outside: outsideOf(document),
    filter: filterOf(document),
    canvas: canvasOf(document),
    ...holes,
  };
  return {
    p: wire(document, "p"),
    ...weights,
    ...depth,
    method,
    ...parameters,
    coincident: document.coincident ?? MEAN,
    grid: infoOf(document).mesh ? "auto" : typeof grid === "number" ? { cell: grid } : grid,
    folds: foldsOf(document),
    output,
  };
}

/**
 * The metric of a warp object, with its mask; methods without a focus have none, which a session
 * has to be told. A mesh of its own follows the mask too.
 * @param {Page.Document} document
 * @returns {Pick<Page.Rest, "metric" | "mask">}
 */
function metricIn(document) {
  const metric = metricOf(document);
  return metric === "geodesic" || infoOf(document).mesh
    ? { metric, mask: { threshold: thresholdOf(document) } }
    : { metric };
}

/**
 * The object of parameters of a method that has one.
 * @param {Page.Document} document
 * @returns {Record<string, Record<string, number>>}
 */
function ownOf(document) {
  const { object, name, parameters } = infoOf(document);
  if (!object) return {};
  /** @type {Record<string, number>} */
  const usual = {};
  for (const own of parameters) if (own.default !== null) usual[own.name] = own.default;
  return { [name]: { ...usual, ...document.own?.[name] } };
}

/**
 * The object of parameters in an answer of the server.
 * @param {Pick<Page.SessionObject, "method">} object
 * @returns {Record<string, Record<string, number>>}
 */
export const ownIn = (object) =>
  infoOf(object).object
    ? { [object.method]: /** @type {Page.Json} */ (object)[object.method] }
    : {};

/**
 * The same without what the image decides and the document does not say.
 * @type {(object: Page.SessionObject, document: Page.Document) => unknown}
 */
function ownKnown(object, document) {
  const { name, parameters } = infoOf(object);
  const own = ownIn(object)[name];
  const isKnown = (/** @type {string} */ key) =>
    document.own?.[name]?.[key] !== undefined ||
    parameters.some((known) => known.name === key && known.default !== null);
  if (!own) return {};
  return { [name]: Object.fromEntries(Object.entries(own).filter(([key]) => isKnown(key))) };
}

/**
 * The defaults of `output`, which an exported warp object leaves out.
 * @type {Required<Page.Rest["output"]>}
 */
const USUAL = { outside: "transparent", filter: "bilinear", canvas: "same", holes: "keep" };

/**
 * Handles whose rest and posed positions are exchanged.
 * @param {Page.Document} document
 * @returns {Page.Document}
 */
export function swapped({ full: _, strength: __, align, ...document }) {
  const handles = (align?.handles ?? document.handles).map(({ p, q, twist, ...handle }) => ({
    ...handle,
    p: q,
    q: p,
    ...(twist && {
      twist: { length: twist.length, angle: -twist.angle + 0, scale: 1 / twist.scale },
    }),
  }));
  const sides = document.sides && { sides: document.sides.toReversed() };
  return { ...document, handles, ...sides };
}

/**
 * The complete warp object, for export. Aligned handles are told as they were, with the alignment.
 * @param {Page.Document} document
 * @returns {Page.Warp}
 */
export function warpOf(document) {
  const { alpha, output, point_mass, smoothing, coincident, metric, mask, folds, ...rest } =
    restOf(document);
  // With twisted pins the server's defaults, which count segments, would be others.
  const twisted = isTwisted(document);
  const mass = twisted || document.mass !== undefined ? { point_mass } : {};
  /** @type {Partial<Page.Warp>} */
  const chosen = {
    ...((twisted || document.alpha !== null) && { alpha }),
    ...mass,
    ...(smoothing && { smoothing }),
    ...(mask && { metric, ...(mask.threshold !== THRESHOLD && { mask }) }),
    ...(document.coincident && { coincident }),
    ...(folds === "remove" && { folds }),
  };
  const names = /** @type {(keyof typeof output)[]} */ (Object.keys(output));
  const told = names.filter((name) => output[name] !== USUAL[name]);
  if (told.length) chosen.output = Object.fromEntries(told.map((name) => [name, output[name]]));
  const { align } = document.full ? {} : document;
  return { ...rest, ...chosen, ...(align && { align: align.by }), q: wire(align ?? document, "q") };
}

/**
 * Whether a session has the same rest handles and parameters as a document.
 * @param {Page.SessionObject} object
 * @param {Page.Document} document
 */
export function sameRest(object, document) {
  const {
    p,
    weights,
    depth,
    method,
    alpha,
    smoothing,
    coincident,
    grid,
    folds,
    output,
    point_mass: mass,
    metric,
    mask,
  } = restOf(document);
  /** @type {(a: unknown, b: unknown) => boolean} */
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  const names = /** @type {(keyof typeof output)[]} */ (Object.keys(output));
  /** @type {[unknown, unknown][]} */
  const pairs = [
    [object.p, p],
    [object.weights, weights],
    [object.depth, depth],
    [object.method, method],
    [object.alpha, alpha],
    [object.smoothing, smoothing],
    [object.metric ?? "euclidean", metric],
    [object.mask, mask],
    [ownKnown(object, document), ownOf(document)],
    [object.coincident_policy ?? MEAN, coincident],
    [object.grid.requested, grid],
    [object.folds === "remove", folds === "remove"],
    ...names.map((name) => /** @type {[unknown, unknown]} */ ([object.output[name], output[name]])),
  ];
  // The server reports the mass of sets with points and segments only.
  const sameMass = object.point_mass == null || near(object.point_mass, mass ?? 1);
  // Its handles would be aligned once more.
  const isPlain = (object.align ?? "none") === "none";
  return object.units === "px" && isPlain && sameMass && pairs.every(([a, b]) => same(a, b));
}
