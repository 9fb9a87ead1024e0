// Annotations (GeoJSON) over the picture, which follow the warp: during a drag by the posed grid of
// the page, at rest by the server, which maps them exactly (`POST /sessions/{id}/points`).

import * as api from "./api.js";
import { contextOf, find, known } from "./dom.js";
import { wire } from "./edits.js";
import { named } from "./handlesfile.js";
import { Broken, lineAndColumn, parse } from "./json.js";
import { isRegionTool } from "./region.js";
import { does } from "./service.js";
import { annotationWords } from "./words.js";

const GEOMETRIES = [
  "Point",
  "MultiPoint",
  "LineString",
  "MultiLineString",
  "Polygon",
  "MultiPolygon",
  "GeometryCollection",
];
/** @type {Set<unknown>} */
const KINDS = new Set(["FeatureCollection", "Feature", ...GEOMETRIES]);
/** Vertices that are drawn in a frame of a motion; of more, every second or third one is. */
const MOST_MOVING = 40_000;
/**
 * Places of a path that are farther apart than this, px, get further places between them, up to
 * this number of parts.
 */
const FAR = 8;
const MOST_PARTS = 64;
/** More vertices are near enough to each other. */
const MOST_REFINED = 100_000;
/** Nesting beyond which nothing is drawn. */
const DEEPEST = 20;
/** Smaller outlines are drawn as a dot, CSS px. */
const DOT = 2;

/** @type {(value: Page.Json) => boolean} */
export const isAnnotations = (value) =>
  Array.isArray(value)
    ? value.length > 0 && value.every((feature) => feature?.type === "Feature")
    : KINDS.has(value?.type);

/**
 * The annotations of a file: { name, geojson }. Throws a Problem.
 * @param {File} file
 * @param {number} most
 * @returns {Promise<Page.Annotations>}
 */
export async function readAnnotations(file, most) {
  /** @type {(detail: string) => Page.Problem} */
  const problem = (detail) => new api.Problem({ code: "bad_annotations", detail }, 0);
  if (file.size > most) throw problem(`The file ${file.name} is too large for this server.`);
  const text = await file.text();
  let geojson;
  try {
    geojson = JSON.parse(text);
  } catch {
    geojson = whereBroken(text, file.name, problem);
  }
  if (!isAnnotations(geojson))
    throw problem(
      `In ${file.name}, a FeatureCollection, a Feature, a list of Features or a geometry is expected.`,
    );
  return { name: file.name, geojson };
}

/**
 * @param {string} text
 * @param {string} name
 * @param {(detail: string) => Page.Problem} problem
 * @returns {Page.Json}
 */
function whereBroken(text, name, problem) {
  try {
    return parse(text).value;
  } catch (error) {
    if (!(error instanceof Broken)) throw error;
    const { line, column } = lineAndColumn(text, error.at);
    throw problem(`In ${name}, line ${line}, column ${column}: ${error.expected} is expected.`);
  }
}

/**
 * Points and outlines of GeoJSON: lists of positions. What is not drawable is left out.
 * @param {Page.Json} geojson
 */
export function pathsOf(geojson) {
  /** @type {Page.Place[][]} */
  const paths = [];
  /** @type {(value: Page.Json) => boolean} */
  const isPlace = (value) =>
    Array.isArray(value) && Number.isFinite(value[0]) && Number.isFinite(value[1]);
  /** @type {(coordinates: Page.Json, depth?: number) => void} */
  const add = (coordinates, depth = 0) => {
    if (depth > DEEPEST) return;
    if (isPlace(coordinates)) paths.push([coordinates]);
    else if (Array.isArray(coordinates) && coordinates.some(isPlace))
      paths.push(coordinates.filter(isPlace));
    else if (Array.isArray(coordinates)) for (const part of coordinates) add(part, depth + 1);
  };
  /** @type {(value: Page.Json, depth?: number) => void} */
  const visit = (value, depth = 0) => {
    if (value === null || typeof value !== "object" || depth > DEEPEST) return;
    if (Array.isArray(value)) return value.forEach((one) => visit(one, depth + 1));
    if (value.type === "FeatureCollection") return visit(value.features, depth);
    if (value.type === "GeometryCollection") return visit(value.geometries, depth);
    if (value.type === "MultiPoint")
      return Array.isArray(value.coordinates)
        ? value.coordinates.forEach((/** @type {Page.Json} */ place) => add([place]))
        : undefined;
    if (GEOMETRIES.includes(value.type)) return add(value.coordinates);
    // Every member of a feature that is a geometry, such as the nucleus of a cell.
    if (value.type === "Feature")
      for (const member of Object.values(value))
        if (GEOMETRIES.includes(member?.type)) visit(member, depth + 1);
  };
  visit(geojson);
  return paths;
}

/**
 * A path with places between those that are far apart, because the warp bends what is between them.
 * @param {Page.Place[]} path
 * @returns {Page.Place[]}
 */
function refined(path) {
  return path.flatMap(([x, y], k) => {
    if (!k) return [[x, y]];
    const [a, b] = path[k - 1];
    const parts = Math.min(MOST_PARTS, Math.ceil(Math.hypot(x - a, y - b) / FAR)) || 1;
    /** @type {(n: number) => Page.Place} */
    const at = (n) => [a + ((x - a) * n) / parts, b + ((y - b) * n) / parts];
    return Array.from({ length: parts }, (_, n) => at(n + 1));
  });
}

/** @type {(geojson: Page.Json) => number} */
export const countOf = (geojson) =>
  (Array.isArray(geojson) ? geojson : (geojson.features ?? geojson.geometries ?? [geojson])).length;

/** @typedef {{ revision: number, cancel: AbortController }} Asking */

export class Annotations {
  /**
   * Those of the state.
   *
   * @type {Page.Annotations | null}
   */
  #of = null;
  /**
   * At rest.
   *
   * @type {Page.Place[][]}
   */
  #paths = [];
  /**
   * By the server.
   *
   * @type {{ revision: number, geojson: Page.Json, paths: Page.Place[][] } | null}
   */
  #mapped = null;
  /** @type {Asking | null} */
  #asking = null;
  /** @type {unknown[]} */
  #drawn = [];

  /**
   * `told`: called when the server has mapped them.
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Page.Sync} sync
   * @param {() => void} told
   */
  constructor(store, view, sync, told) {
    this.store = store;
    this.view = view;
    this.sync = sync;
    this.told = told;
    this.context = contextOf(find("annotations"), { willReadFrequently: true });
    find("annotations-shown").addEventListener("change", () => this.#draw());
    find("annotations-remove").addEventListener("click", () =>
      store.do("annotations", { annotations: null }),
    );
    store.subscribe((state) => this.#follow(state));
    sync.subscribe(() => this.#ask());
    view.subscribe(() => this.#draw());
    view.afterDraw(() => this.#draw());
  }

  /** @param {Page.State} state */
  #follow({ annotations }) {
    find("annotations-panel").hidden = !annotations;
    if (annotations !== this.#of) {
      this.#of = annotations;
      const paths = annotations ? pathsOf(annotations.geojson) : [];
      this.#paths =
        paths.reduce((sum, path) => sum + path.length, 0) > MOST_REFINED
          ? paths
          : paths.map(refined);
      this.#mapped = null;
      if (annotations)
        find("annotations-note").textContent = annotationWords(
          annotations.name,
          countOf(annotations.geojson),
        );
    }
    this.#ask();
    this.#draw();
  }

  /** Has the annotations of the shown picture mapped, once it is the server's. */
  #ask() {
    const { revision, document } = this.store.state;
    const { shown, session } = this.sync;
    const settled = this.sync.condition === "ready" && shown.revision === revision;
    if (this.#asking?.revision !== revision || !settled || !this.#of) {
      this.#asking?.cancel.abort();
      this.#asking = null;
    }
    if (
      !does.annotations ||
      !this.#of ||
      !settled ||
      this.#asking ||
      this.#mapped?.revision === revision
    )
      return;
    this.#asking = { revision, cancel: new AbortController() };
    this.#map(known(session).id, document, this.#asking, shown.report?.canvas ?? [0, 0]);
  }

  /**
   * @param {string} id
   * @param {Page.Document} document
   * @param {Asking} asking
   * @param {number[]} origin
   */
  async #map(id, document, asking, [x, y]) {
    const { name, geojson } = known(this.#of);
    try {
      const mapped = (
        await api.points(id, { q: wire(document, "q"), geojson }, asking.cancel.signal)
      ).geojson;
      if (this.#asking !== asking) return;
      // Positions are those of the server's picture, whose canvas may begin elsewhere.
      const origin = [x, y];
      const paths = pathsOf(mapped).map((path) =>
        path.map((place) => place.map((c, axis) => c + origin[axis])),
      );
      this.#mapped = { revision: asking.revision, geojson: mapped, paths };
      this.#draw();
      this.told();
    } catch (error) {
      if (api.wasAborted(error) || this.#asking !== asking) return;
      const { pointer, detail: told } = api.asProblem(error);
      // They cannot be used: as after a file that cannot be read.
      this.store.do("annotations", { annotations: null });
      const where = pointer?.startsWith("/geojson")
        ? ` at ${named(pointer.replace("/geojson", "")) || "the start"}`
        : "";
      const detail = `In ${name},${where || " as a whole"}: ${told}`;
      this.store.do("problem", {
        problem: Object.assign(new api.Problem({ code: "bad_annotations", detail }, 0), {
          opening: true,
        }),
      });
    } finally {
      if (this.#asking === asking) this.#asking = null;
    }
  }

  /**
   * What is drawn: `exact` the server's positions of the shown pose, `mesh` those by the posed
   * grid, or an empty text.
   */
  get shown() {
    if (!this.#of) return "";
    return this.#mapped?.revision === this.store.state.revision ? "exact" : "mesh";
  }

  /** The annotations in the frame of "Download PNG". */
  async mapped() {
    await this.sync.settled();
    const { document, revision } = this.store.state;
    if (this.#mapped?.revision === revision) return this.#mapped.geojson;
    const { geojson } = known(this.#of);
    return (await this.sync.ask((id) => api.points(id, { q: wire(document, "q"), geojson })))
      .geojson;
  }

  #draw() {
    const { state } = this.store;
    const { view, context } = this;
    const seen =
      this.#of &&
      view.size &&
      state.phase === "open" &&
      !state.compare &&
      find("annotations-shown").checked;
    const { canvas } = context;
    if (!seen) {
      canvas.hidden = true;
      this.#drawn = [];
      return;
    }
    const atRest = state.peek || isRegionTool(state.tool);
    const isExact =
      !atRest &&
      view.source === "png" &&
      state.playing === null &&
      this.#mapped?.revision === this.sync.shown.revision;
    const mesh = atRest || isExact ? null : view.shownMesh;
    const paths = isExact ? known(this.#mapped).paths : this.#paths;
    const { zoom, pan, stageSize, scale } = view;
    const now = [paths, mesh, zoom, ...pan, ...stageSize, scale];
    if (!canvas.hidden && now.every((part, k) => part === this.#drawn[k])) return;
    this.#drawn = now;
    canvas.hidden = false;
    Object.assign(canvas, {
      width: Math.max(1, Math.round(stageSize[0] * scale)),
      height: Math.max(1, Math.round(stageSize[1] * scale)),
    });
    const moving = state.before !== null || state.playing !== null;
    this.#stroke(paths, mesh, moving);
  }

  /**
   * @param {Page.Place[][]} paths
   * @param {Page.Mesh | null} mesh
   * @param {boolean} moving
   */
  #stroke(paths, mesh, moving) {
    const { context, view } = this;
    const [wide, high] = view.stageSize;
    const all = paths.reduce((sum, path) => sum + path.length, 0);
    const step = moving ? Math.max(1, Math.ceil(all / MOST_MOVING)) : 1;
    context.scale(view.scale, view.scale);
    context.beginPath();
    for (const path of paths) {
      const isOne = path.length === 1;
      let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
      const posed = [];
      const last = path.length - 1;
      for (let k = 0; k <= last; k = k === last ? k + 1 : Math.min(last, k + step)) {
        const place = mesh ? mesh.forward(path[k][0], path[k][1]) : path[k];
        if (!place) continue;
        const [x, y] = view.toStage(place);
        posed.push(x, y);
        [left, top, right, bottom] = [
          Math.min(left, x),
          Math.min(top, y),
          Math.max(right, x),
          Math.max(bottom, y),
        ];
      }
      if (!posed.length || right < 0 || bottom < 0 || left > wide || top > high) continue;
      if (isOne) {
        context.moveTo(posed[0] + 3, posed[1]);
        context.arc(posed[0], posed[1], 3, 0, 2 * Math.PI);
      } else if (right - left < DOT && bottom - top < DOT) context.rect(left, top, 1, 1);
      else
        for (let k = 0; k < posed.length; k += 2)
          k ? context.lineTo(posed[k], posed[k + 1]) : context.moveTo(posed[0], posed[1]);
    }
    for (const [colour, width] of [
      ["rgb(0 0 0 / .6)", 3.5],
      ["#ffe14d", 1.5],
    ]) {
      Object.assign(context, { strokeStyle: colour, lineWidth: width, lineJoin: "round" });
      context.stroke();
    }
  }
}
