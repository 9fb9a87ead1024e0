// The store: document (handles, method, alpha, grid, outside, filter, canvas, region), selection
// and history. Reducers are pure functions of state and action. Views subscribe.

import { isRegionTool } from "./region.js";
import { settled } from "./strength.js";

/** @typedef {(state: Page.State, previous: Page.State) => void} Subscriber */

/** Maximum number of undo steps. */
const STEPS = 200;
/** Steps with the same tag within this time, ms, are merged. */
const TOGETHER = 800;

/** @type {() => Page.Document} */
export const emptyDocument = () => ({
  handles: [],
  method: "rigid",
  alpha: null,
  grid: "auto",
  outside: "transparent",
  filter: "bilinear",
  canvas: "same",
  region: [],
  feather: 0,
  holes: null,
});

/** @type {() => Page.State} */
const initialState = () => ({
  phase: "empty", // empty, uploading, open
  progress: 0,
  picture: null, // { name, width, height, sample, linked }
  document: emptyDocument(),
  revision: 0,
  selection: [], // "7" is a whole handle, "7.2" a vertex of it
  tool: "point",
  draft: [],
  arm: "",
  more: false,
  cross: null, // position of the keyboard cross, picture px
  before: null, // the document at the start of a drag
  past: [],
  future: [],
  earlier: [], // pictures that undo brings back, oldest first (pictures.js)
  later: [], // pictures that redo brings back, next one first
  waiting: null, // what waits for its picture: { handles: { name, document, warp } (handlesfile.js), annotations }
  annotations: null, // GeoJSON over the picture: { name, geojson }
  unused: [], // names of the files that were opened with others, and not used
  sidesClosed: false, // whether the user has closed what is told about rest and pose
  holesClosed: false, // and about holes
  tag: "",
  tagged: 0,
  problem: null,
  fit: null, // why the method was chosen: { residuals, outliers, scale, words } (fit.js)
  fitShown: true,
  apart: [], // indices of handles that coincide at rest and are moved apart
  meshShown: false,
  compare: false,
  compareAt: 50,
  peek: false,
  removes: false, // whether lasso and brush take away from the region
  brush: null, // size of the brush, px; null: by the size of the picture
  regionShown: false,
  playing: null, // "preparing", or the strength that is shown while the animation plays (player.js)
  animation: { easing: "ease-in-out", back: true, frames: 24, file: "apng" },
});

/** @type {(key: string) => number} */
const idOf = (key) => Number(key.split(".")[0]);

/**
 * Whether a selection key still exists.
 * @param {Page.Document} document
 * @param {string} key
 */
function exists(document, key) {
  const handle = document.handles.find((h) => h.id === idOf(key));
  if (!handle) return false;
  const vertex = key.includes(".") ? Number(key.split(".")[1]) : 0;
  return vertex < handle.p.length;
}

/**
 * @param {Page.State} state
 * @param {Page.Document} document
 * @returns {Page.State}
 */
function withDocument(state, document) {
  if (document === state.document) return state;
  const kept = state.selection.filter((key) => exists(document, key));
  const selection = kept.length === state.selection.length ? state.selection : kept;
  const isKept = /** @type {const} */ (["handles", "method", "alpha", "smoothing"]).every(
    (name) => document[name] === state.document[name],
  );
  return {
    ...state,
    document,
    selection,
    revision: state.revision + 1,
    problem: null,
    apart: [],
    fit: isKept ? state.fit : null,
  };
}

/**
 * A selection of handles ends the work on the region, which hides them.
 * @type {(state: Page.State, selection: string[]) => Page.State}
 */
const selecting = (state, selection) => ({
  ...state,
  selection,
  ...(selection.length && isRegionTool(state.tool) && { tool: "point", regionShown: false }),
});

/**
 * @type {(state: Page.State, document: Page.Document) => Pick<Page.State, "past" | "future" |
 * "later">}
 */
const remembered = (state, document) => ({
  past: [...state.past, document].slice(-STEPS),
  future: [],
  later: [],
});

/**
 * @type {{ [Name in keyof Page.Actions]: (state: Page.State, content: Page.Actions[Name]) =>
 * Page.State }}
 */
const reducers = {
  uploading: (state, { name }) => ({
    ...state,
    phase: "uploading",
    progress: 0,
    uploadName: name,
    problem: null,
  }),
  progress: (state, { percent }) => ({ ...state, progress: percent }),
  uploadEnded: (state) => ({ ...state, phase: state.picture ? "open" : "empty" }),

  /** Opens another picture, with its handles and history; `picture` null closes the open one. */
  opened: (
    state,
    {
      picture,
      document = emptyDocument(),
      annotations = null,
      past = [],
      future = [],
      earlier,
      later,
    },
  ) => ({
    ...initialState(),
    phase: picture ? "open" : "empty",
    picture,
    document,
    annotations,
    past,
    future,
    earlier,
    later,
    revision: state.revision + 1,
    tool: isRegionTool(state.tool) ? "point" : state.tool,
    meshShown: state.meshShown,
    animation: state.animation,
  }),
  history: (state, { earlier, later }) => ({ ...state, earlier, later }),
  waiting: (
    state,
    { handles = state.waiting?.handles, annotations = state.waiting?.annotations },
  ) => ({
    ...state,
    waiting: handles || annotations ? { handles, annotations } : null,
    problem: null,
  }),
  annotations: (state, { annotations }) => ({ ...state, annotations, problem: null }),
  unused: (state, { names }) => ({ ...state, unused: names }),

  /** One undo step. Quick successive steps with one tag are merged. */
  edit: (state, { document, select, tag = "", now = 0 }) => {
    if (document === state.document) return state;
    const joins = tag !== "" && tag === state.tag && now - state.tagged < TOGETHER;
    const history = joins ? { future: [], later: [] } : remembered(state, state.document);
    const next = withDocument(
      { ...state, ...history, tag, tagged: now },
      settled(document, state.document),
    );
    return select ? selecting(next, select) : next;
  },

  fit: (state, { fit }) => ({ ...state, fit }),

  dragBegin: (state) => ({ ...state, before: state.document, tag: "" }),
  drag: (state, { document }) => withDocument(state, settled(document, state.document)),
  dragEnd: (state) => {
    if (!state.before) return state;
    const history = state.before === state.document ? {} : remembered(state, state.before);
    return { ...state, ...history, before: null };
  },
  dragCancel: (state) =>
    state.before ? { ...withDocument(state, state.before), before: null } : state,

  undo: (state) => {
    if (!state.past.length || state.before) return state;
    const next = {
      ...state,
      past: state.past.slice(0, -1),
      future: [state.document, ...state.future],
      draft: [],
      tag: "",
    };
    return withDocument(next, /** @type {Page.Document} */ (state.past.at(-1)));
  },
  redo: (state) => {
    if (!state.future.length || state.before) return state;
    const next = {
      ...state,
      past: [...state.past, state.document],
      future: state.future.slice(1),
      draft: [],
      tag: "",
    };
    return withDocument(next, state.future[0]);
  },

  select: (state, { keys }) => {
    const selection = keys.filter((key) => exists(state.document, key));
    return {
      ...selecting(state, selection),
      arm: selection.length ? state.arm : "",
      more: selection.length ? state.more : false,
    };
  },
  toggle: (state, { key }) => {
    // A handle and one of its vertices are never selected together.
    const others = state.selection.filter(
      (k) => idOf(k) !== idOf(key) || (k.includes(".") && key.includes(".")),
    );
    const selection = state.selection.includes(key)
      ? state.selection.filter((k) => k !== key)
      : [...others, key];
    return { ...selecting(state, selection), arm: "" };
  },

  /** The tools for the region show the picture at rest, without handles. */
  tool: (state, { tool }) => {
    /** @type {Partial<Page.State>} */
    const region = isRegionTool(tool)
      ? { selection: [], arm: "", more: false, compare: false }
      : {};
    return {
      ...state,
      tool,
      draft: [],
      ...region,
      ...(tool !== state.tool && { regionShown: isRegionTool(tool) }),
    };
  },
  draft: (state, { places }) => ({ ...state, draft: places }),
  arm: (state, { arm }) => ({ ...state, arm: state.selection.length ? arm : "", draft: [] }),
  more: (state, { more }) => ({ ...state, more }),
  cross: (state, { place }) => ({ ...state, cross: place }),
  problem: (state, { problem }) => ({ ...state, problem }),
  apart: (state, { handles }) => ({ ...state, apart: handles }),
  play: (state, { playing }) => ({ ...state, playing }),
  animation: (state, { change }) => ({ ...state, animation: { ...state.animation, ...change } }),
  show: (state, { what }) => ({ ...state, ...what }),
};

/**
 * Steps that undo and redo can take: those of the open picture and of the other ones, and one for
 * each change of the picture.
 * @param {Pick<Page.State, "past" | "future" | "earlier" | "later">} state
 */
export function steps({ past, future, earlier, later }) {
  /** @type {(own: unknown[], others: Page.Kept[], which: "past" | "future") => number} */
  const all = (own, others, which) =>
    others.reduce((sum, picture) => sum + 1 + (picture[which]?.length ?? 0), own.length);
  return { undo: all(past, earlier, "past"), redo: all(future, later, "future") };
}

export class Store {
  #state = initialState();
  /** @type {Set<Subscriber>} */
  #views = new Set();
  #telling = false;
  /** @type {Page.State | null} */
  #previous = null;

  get state() {
    return this.#state;
  }

  /**
   * Notifies every view; actions of views during the notification cause one more round.
   * @template {keyof Page.Actions} Name
   * @param {Name} type
   * @param {Page.Actions[Name]} [content]
   */
  do(type, content) {
    const before = this.#state;
    this.#state = reducers[type](before, /** @type {Page.Actions[Name]} */ (content ?? {}));
    if (this.#state === before) return;
    this.#previous ??= before;
    if (this.#telling) return;
    this.#telling = true;
    try {
      while (this.#previous) {
        const previous = this.#previous;
        this.#previous = null;
        for (const view of this.#views) view(this.#state, previous);
      }
    } finally {
      this.#telling = false;
    }
  }

  /**
   * Returns a function that ends the subscription.
   * @param {Subscriber} view
   */
  subscribe(view) {
    this.#views.add(view);
    return () => this.#views.delete(view);
  }
}
