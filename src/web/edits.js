// Edits of a document: pure functions that return a new document, or the same one if nothing changes. Positions are [x, y] in picture px,
// rounded to 0.01, so that the table shows the values that are sent.

export const kindOf = (handle) => ["point", "line"][handle.p.length - 1] ?? "path";
export const kindName = (handle) => ({ point: "Point", line: "Line", path: "Path" })[kindOf(handle)];

/** The server's limit of a coordinate. */
const REACH = 1e6;
const round = (x) => Math.min(REACH, Math.max(-REACH, Math.round(x * 100) / 100)) + 0;
export const rounded = ([x, y]) => [round(x), round(y)];

const same = (a, b) => a[0] === b[0] && a[1] === b[1];
const idOf = (key) => Number(key.split(".")[0]);
const vertexOf = (key) => (key.includes(".") ? Number(key.split(".")[1]) : null);

/** The selected vertices: Map of handle id to vertex indices. Vertices of one handle that coincide at rest are selected together. */
export function placesOf(document, selection) {
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

/** Posed positions of a selection. */
export function posedPlaces(document, selection) {
  const places = placesOf(document, selection);
  return document.handles.flatMap((h) => [...(places.get(h.id) ?? [])].map((k) => h.q[k]));
}

/** Maps every posed position of a selection by `to`. */
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

export const translated = (document, selection, dx, dy) => moved(document, selection, ([x, y]) => [x + dx, y + dy]);

export function rotated(document, selection, [cx, cy], angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return moved(document, selection, ([x, y]) => [cx + (x - cx) * cos - (y - cy) * sin, cy + (x - cx) * sin + (y - cy) * cos]);
}

/** Centre and radius of the circle around positions. */
export function circleOf(places) {
  const xs = places.map((p) => p[0]);
  const ys = places.map((p) => p[1]);
  const centre = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  return { centre, radius: Math.max(...places.map((p) => Math.hypot(p[0] - centre[0], p[1] - centre[1]))) };
}

export function putBack(document, selection) {
  const places = placesOf(document, selection);
  let changed = false;
  const handles = document.handles.map((handle) => {
    const mine = places.get(handle.id);
    if (!mine || [...mine].every((k) => same(handle.p[k], handle.q[k]))) return handle;
    changed = true;
    return { ...handle, q: handle.q.map((place, k) => (mine.has(k) ? handle.p[k] : place)) };
  });
  return changed ? { ...document, handles } : document;
}

/** Removes whole handles, and vertices of paths while two remain. */
export function removed(document, selection) {
  const handles = document.handles.flatMap((handle) => {
    const keys = selection.filter((key) => idOf(key) === handle.id);
    if (!keys.length) return [handle];
    const gone = new Set(keys.map(vertexOf));
    const stays = (_, k) => !gone.has(k);
    const p = handle.p.filter(stays);
    if (gone.has(null) || p.length < 2 || !segmentsHaveLength(p)) return [];
    return [{ ...handle, p, q: handle.q.filter(stays) }];
  });
  return handles.length === document.handles.length && handles.every((h, i) => h === document.handles[i]) ? document : { ...document, handles };
}

const segmentsHaveLength = (p) => p.every((place, k) => k === 0 || !same(place, p[k - 1]));

/** Adds a handle; `null` if all of its segments would have zero length at rest. Repeated positions are dropped. */
export function added(document, p, q) {
  const rest = p.map(rounded);
  const keep = rest.map((place, k) => k === 0 || !same(place, rest[k - 1]));
  const id = 1 + Math.max(0, ...document.handles.map((h) => h.id));
  const handle = { id, p: rest.filter((_, k) => keep[k]), q: q.map(rounded).filter((_, k) => keep[k]) };
  if (p.length > 1 && handle.p.length < 2) return null;
  return { document: { ...document, handles: [...document.handles, handle] }, key: String(id) };
}

/** Sets one coordinate of the table. */
export function withNumber(document, which, index, vertex, axis, value) {
  const old = document.handles[index];
  const places = old[which].map((place, k) => {
    if (k !== vertex) return place;
    const next = [...place];
    next[axis] = round(value);
    return next;
  });
  if (same(places[vertex], old[which][vertex])) return document;
  const handles = document.handles.with(index, { ...old, [which]: places });
  return { ...document, handles };
}

/** A closed path around the picture. */
export function borderPath(width, height) {
  return [[0, 0], [width, 0], [width, height], [0, height], [0, 0]];
}

/** Handles in the server's form, p or q: a point is [x, y], a line is a list of positions. */
export const wire = (document, which) => document.handles.map((h) => (h[which].length === 1 ? h[which][0] : h[which]));

/** Alpha; the server's default is 2 with any line, otherwise 1. */
export const alphaOf = ({ alpha, handles }) => alpha ?? (handles.some((h) => h.p.length > 1) ? 2 : 1);

/** The content outside the warped picture: `transparent`, `edge` or `#rrggbbaa`. Documents of older pages lack it. */
export const outsideOf = ({ outside }) => outside ?? "transparent";

/** The session's part of a warp object. Alpha and outside are always included: an absent field keeps the session's value. */
export function restOf(document) {
  const { handles, method, grid } = document;
  const weights = handles.some((h) => h.weight !== undefined) ? { weights: handles.map((h) => h.weight ?? 1) } : {};
  const output = { outside: outsideOf(document) };
  return { p: wire(document, "p"), ...weights, method, alpha: alphaOf(document), grid: grid === "auto" ? grid : { cell: grid }, output };
}

/** The complete warp object, for export. */
export function warpOf(document) {
  const { alpha, output, ...rest } = restOf(document);
  const chosen = { ...(document.alpha !== null && { alpha }), ...(output.outside !== "transparent" && { output }) };
  return { ...rest, ...chosen, q: wire(document, "q") };
}

/** Whether a session has the same rest handles and parameters as a document. */
export function sameRest(object, document) {
  const { p, weights, method, alpha, grid, output } = restOf(document);
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  const pairs = [[object.p, p], [object.weights, weights], [object.method, method], [object.alpha, alpha], [object.grid.requested, grid], [object.output.outside, output.outside]];
  return object.units === "px" && pairs.every(([a, b]) => same(a, b));
}
