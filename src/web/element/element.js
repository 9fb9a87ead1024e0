// <mls-warp>: a picture whose handles can be dragged. The class is safe to import without a DOM.

import { Client } from "../../../api/npm/client/index.js";
import { alphaOf, warpOf, wire } from "../edits.js";
import { Store } from "../state.js";
import { atStrength, strengthOf } from "../strength.js";
import page from "../stage.css";
import own from "./element.css";
import { Local } from "./local.js";
import { Remote } from "./remote.js";
import { Stage, fileOf } from "./stage.js";
import { fits, handlesOf, placesIn, settingsOf } from "./wire.js";

/** @typedef {import("./wire.js").GivenWarp} GivenWarp */
/** @typedef {Blob | ImageBitmap | ImageData | string | URL | null} GivenImage */

/** Without a DOM there is a class too, which cannot be constructed. */
const Base = /** @type {typeof HTMLElement} */ (globalThis.HTMLElement ?? class {});
/** Properties that may be set before the class is there. */
const PROPERTIES = /** @type {const} */ ([
  "client",
  "image",
  "method",
  "alpha",
  "warp",
  "p",
  "q",
  "strength",
  "tool",
]);
const TOOLS = ["point", "line", "path"];
/** @type {(name: string) => name is Page.Tool} */
const isTool = (name) => TOOLS.includes(name);

/**
 * The style sheet of all elements in a window: one that was made in another cannot be adopted.
 *
 * @type {WeakMap<Window, CSSStyleSheet>}
 */
const styles = new WeakMap();
/** @param {Window & typeof globalThis} view */
function styleOf(view) {
  const sheet = styles.get(view) ?? new view.CSSStyleSheet();
  if (!styles.has(view)) sheet.replaceSync(`${page}\n${own}`);
  styles.set(view, sheet);
  return sheet;
}

export class MlsWarp extends Base {
  static observedAttributes = [
    "src",
    "server",
    "session",
    "method",
    "alpha",
    "strength",
    "tool",
    "readonly",
    "handles",
  ];

  /** That of the stage: a new stage gets a new one. */
  #store = new Store();
  #root = this.attachShadow({ mode: "open", delegatesFocus: true });
  /** The proportions of the picture. */
  #shape = { text: "", sheet: /** @type {CSSStyleSheet | null} */ (null) };
  /** @type {Stage | null} */
  #stage = null;
  /** What warps: a server, or the engine here. @type {import("./follower.js").Follower | null} */
  #warper = null;
  /** @type {GivenImage} */
  #image = null;
  /** @type {Client | null} */
  #client = null;
  /** Posed handles that wait for those at rest. @type {Page.Place[][] | null} */
  #posed = null;
  #isHost = false;
  #isReady = false;
  /** Of the picture that is being loaded. @type {AbortController | null} */
  #loading = null;
  #due = false;

  constructor() {
    super();
    this.#dress();
    this.#store.subscribe((state, previous) => this.#follow(state, previous));
  }

  #dress() {
    const view = this.ownerDocument.defaultView ?? window;
    const sheet = new view.CSSStyleSheet();
    sheet.replaceSync(this.#shape.text);
    this.#shape.sheet = sheet;
    this.#root.adoptedStyleSheets = [styleOf(view), sheet];
  }

  /** What the stage has shown is kept for the next one. */
  #renew() {
    const { document, past, future, tool } = this.#store.state;
    this.#store = new Store();
    this.#store.do("opened", { picture: null, document, past, future, earlier: [], later: [] });
    this.#store.do("tool", { tool });
    this.#store.subscribe((state, previous) => this.#follow(state, previous));
  }

  connectedCallback() {
    for (const name of PROPERTIES) {
      if (!Object.hasOwn(this, name)) continue;
      const value = this[name];
      delete (/** @type {any} */ (this)[name]);
      /** @type {any} */ (this)[name] = value;
    }
    if (!this.#stage) this.#load();
  }

  disconnectedCallback() {
    // Moved, perhaps: what is needed again in the same task is kept.
    queueMicrotask(() => !this.isConnected && this.#release());
  }

  /** Another document has adopted it, without its style sheets. */
  adoptedCallback() {
    this.#dress();
  }

  /** A move within the document changes nothing. */
  connectedMoveCallback() {}

  #release() {
    this.#loading?.abort();
    this.#warper?.release();
    this.#stage?.release();
    this.#warper = this.#stage = null;
    this.#isReady = false;
    this.#root.replaceChildren();
    this.#renew();
  }

  /**
   * @param {string} name
   * @param {string | null} before
   * @param {string | null} value
   */
  attributeChangedCallback(name, before, value) {
    if (value === before) return;
    if (name === "src" || name === "session") this.#load();
    else if (name === "server") {
      this.#client = null;
      this.#load();
    } else if (name === "readonly") this.#showReadonly();
    else if (value !== null) this.#attribute(name, value);
  }

  /**
   * @param {string} name
   * @param {string} value
   */
  #attribute(name, value) {
    try {
      if (name === "handles") {
        const given = JSON.parse(value);
        this.warp = Array.isArray(given) ? { p: given } : given;
      } else if (name === "alpha" || name === "strength") this[name] = Number(value);
      else if (name === "method" || name === "tool") this[name] = value;
    } catch (error) {
      this.#tell(error);
    }
  }

  /**
   * @param {string} name
   * @param {string | null | undefined} value
   */
  #reflect(name, value) {
    if (value === null || value === undefined) this.removeAttribute(name);
    else this.setAttribute(name, value);
  }

  // Properties

  /** The address of the picture: the attribute. */
  get src() {
    return this.getAttribute("src") ?? "";
  }
  set src(/** @type {string | null | undefined} */ address) {
    this.#reflect("src", address);
  }

  /** The address of the server: the attribute. */
  get server() {
    return this.getAttribute("server") ?? "";
  }
  set server(/** @type {string | null | undefined} */ address) {
    this.#reflect("server", address);
  }

  /** The id of the session that is used: the attribute. */
  get session() {
    return this.getAttribute("session") ?? "";
  }
  set session(/** @type {string | null | undefined} */ id) {
    this.#reflect("session", id);
  }

  get readonly() {
    return this.hasAttribute("readonly");
  }
  set readonly(is) {
    this.toggleAttribute("readonly", is);
  }

  /** The client of `./client` that it uses: for a token, in place of `server`. */
  get client() {
    if (!this.#client && this.server) this.#client = new Client({ server: this.server });
    return this.#client;
  }
  set client(client) {
    if (client === this.#client) return;
    this.#client = client;
    this.#load();
  }

  /** The picture: a file, a bitmap, pixels or an address. `src`, if it was not set. */
  get image() {
    return this.#image ?? (this.src || null);
  }
  set image(image) {
    if (image === this.#image) return;
    this.#image = image;
    this.#load();
  }

  /** Handles at rest, in px of the picture. Setting them keeps `q` if it fits. */
  get p() {
    return wire(this.#store.state.document, "p");
  }
  set p(p) {
    const rest = placesIn(p, "p");
    if (JSON.stringify(p) === JSON.stringify(this.p)) return;
    const posed = this.#posed ?? this.#full.map(({ q }) => q);
    this.#posed = null;
    this.#set({ handles: handlesOf(rest, fits(rest, posed) ? posed : rest) });
  }

  /** Posed handles, at full strength. */
  get q() {
    return wire({ handles: this.#full }, "q");
  }
  set q(q) {
    const posed = placesIn(q, "q");
    if (JSON.stringify(q) === JSON.stringify(this.q)) return;
    const handles = this.#full;
    const rest = handles.map(({ p }) => p);
    // Properties may be set in any order: those at rest may follow.
    if (fits(rest, posed))
      this.#set({
        handles: handles.map(({ twist: _, ...handle }, k) => ({ ...handle, q: posed[k] })),
      });
    else {
      this.#posed = posed;
      queueMicrotask(() => {
        if (this.#posed === posed) this.#tell(new TypeError("q has not the shape of p"));
      });
    }
  }

  get #full() {
    const { full, handles } = this.#store.state.document;
    return full ?? handles;
  }

  /** A warp object: handles and settings. It can be sent to the server as it is. */
  get warp() {
    const { document } = this.#store.state;
    const strength = strengthOf(document);
    return { ...warpOf({ ...document, handles: this.#full }), ...(strength !== 1 && { strength }) };
  }
  set warp(/** @type {GivenWarp} */ warp) {
    const rest = placesIn(warp.p ?? [], "p");
    const posed = warp.q ? placesIn(warp.q, "q") : rest;
    if (!fits(rest, posed)) throw new TypeError("q has not the shape of p");
    if (JSON.stringify(warp) === JSON.stringify(this.warp)) return;
    this.#posed = null;
    const { weights, depth, point_mass: mass, strength = 1 } = warp;
    const handles = handlesOf(rest, posed, weights, mass, depth);
    this.#set({ ...settingsOf(warp), handles }, strength);
  }

  get method() {
    return this.#store.state.document.method;
  }
  set method(method) {
    this.#set(settingsOf({ method }), this.strength);
  }

  /** How quickly the influence of a handle falls off. Setting null makes it automatic. */
  get alpha() {
    return alphaOf(this.#store.state.document);
  }
  set alpha(/** @type {number | null} */ alpha) {
    if (alpha !== null && !Number.isFinite(alpha)) throw new TypeError("alpha: a number");
    this.#set({ alpha }, this.strength);
  }

  /** The part of the way from rest to `q` that is shown. */
  get strength() {
    return strengthOf(this.#store.state.document);
  }
  set strength(strength) {
    if (!Number.isFinite(strength)) throw new TypeError("strength: a number");
    this.#set({}, strength);
  }

  /** What a click at an empty position makes: `point`, `line` or `path`. */
  get tool() {
    return this.#store.state.tool;
  }
  set tool(/** @type {string} */ tool) {
    if (!isTool(tool)) throw new TypeError(`tool: one of ${TOOLS.join(", ")}`);
    this.#store.do("tool", { tool });
  }

  /** `empty`, `loading`, `busy`, `ready` (the server's picture of the pose is shown) or `error`. */
  get state() {
    if (!this.#store.state.picture) return this.#loading ? "loading" : "empty";
    return this.#warper?.condition ?? "empty";
  }

  /** The largest distance between a handle and where it is shown, px; null if it is not known. */
  get residual() {
    return this.#warper?.residual ?? null;
  }

  // Methods

  /**
   * The warped picture as a file: the server's, or without one, the same bytes of the engine.
   *
   * @param {string} [type] a media type
   * @param {{ width?: number, quality?: number }} [options] `quality`: of a JPEG, 0 to 1
   * @returns {Promise<Blob>}
   */
  async toBlob(type = "image/png", { width, quality } = {}) {
    if (!this.#warper) throw new DOMException("there is no picture", "InvalidStateError");
    const format = type.replace("image/", "");
    const percent = quality === undefined ? {} : { quality: Math.round(100 * quality) };
    return this.#warper.file({ format, ...(width && { width }), ...percent });
  }

  undo() {
    this.#stage?.actions.undo(true);
  }

  redo() {
    this.#stage?.actions.undo(false);
  }

  /**
   * Shows the whole picture, or `zoom` CSS px for each pixel of the picture.
   *
   * @param {"fit" | number} zoom
   */
  zoomTo(zoom) {
    if (zoom === "fit") this.#stage?.view.fit();
    else this.#stage?.view.zoomTo(zoom);
  }

  /**
   * Moves the focus to a handle.
   *
   * @param {number} index
   */
  focusHandle(index) {
    const handle = this.#store.state.document.handles[index];
    if (handle) this.#stage?.handles.focus(index, handle.p.length > 1 ? 0 : null);
  }

  // What follows

  /**
   * A change of the site, which hears no event of it.
   *
   * @param {Partial<Page.Document>} change to the document at full strength
   * @param {number} [strength]
   */
  #set(change, strength = 1) {
    const store = this.#store;
    const { document, picture, before } = store.state;
    if (before) store.do("dragCancel");
    const { full, strength: _, ...rest } = document;
    const whole = { ...rest, handles: full ?? document.handles, ...change };
    const next = strength === 1 ? whole : atStrength(whole, strength);
    this.#isHost = true;
    if (picture) store.do("edit", { document: next });
    else store.do("opened", { picture: null, document: next, earlier: [], later: [] });
    this.#isHost = false;
  }

  /**
   * @param {Page.State} state
   * @param {Page.State} previous
   */
  #follow(state, previous) {
    if (this.#isHost || !state.picture || state.picture !== previous.picture) return;
    const isChanged = state.document !== previous.document;
    if (state.before) {
      if (isChanged) this.#fire("warpinput");
    } else if (previous.before ? previous.before !== state.document : isChanged)
      this.#fire("warpchange");
  }

  /**
   * @param {string} type
   * @param {unknown} [detail]
   */
  #fire(type, detail = { p: this.p, q: this.q, strength: this.strength }) {
    this.dispatchEvent(new CustomEvent(type, { bubbles: true, composed: true, detail }));
  }

  /** @param {unknown} error */
  #tell(error) {
    const problem = /** @type {any} */ (error)?.problem;
    // The handles that it names are marked.
    if (problem) this.#store.do("problem", { problem });
    this.#fire("warperror", error);
  }

  #showReadonly() {
    const { stage } = this.#stage ?? {};
    if (!stage) return;
    stage.setAttribute("role", this.readonly ? "img" : "application");
    stage.setAttribute("aria-label", this.getAttribute("aria-label") ?? "Picture");
    if (this.readonly) stage.removeAttribute("tabindex");
    else stage.setAttribute("tabindex", "0");
  }

  /** Loads the picture, once for all that is set in one task. */
  #load() {
    if (this.#due || !this.isConnected) return;
    this.#due = true;
    queueMicrotask(() => {
      this.#due = false;
      if (this.isConnected) this.#open();
    });
  }

  async #open() {
    this.#loading?.abort();
    this.#warper?.release();
    this.#warper = null;
    this.#isReady = false;
    if (!this.#stage) {
      this.#stage = new Stage(this.#root, this.#store, () => this.#warper);
      this.#showReadonly();
    }
    const loading = new AbortController();
    this.#loading = loading;
    const { signal } = loading;
    try {
      const session = await this.#existing(signal);
      const blob = session?.blob ?? (await this.#file(signal));
      if (!blob) return;
      const bitmap = await createImageBitmap(blob);
      const { width, height } = bitmap;
      bitmap.close();
      signal.throwIfAborted();
      this.#shape.text = `:host { aspect-ratio: ${width} / ${height} }`;
      this.#shape.sheet?.replaceSync(this.#shape.text);
      const isCutout = await this.#stage.view.setPicture(blob, width, height, signal);
      const picture = { name: "picture", width, height, isCutout };
      const { document, past, future } = this.#store.state;
      const opened = { picture, document, past, future, earlier: [], later: [] };
      this.#store.do("opened", opened);
      this.#stage.view.resized();
      this.#warpBy(blob, session?.session ?? null);
    } catch (error) {
      if (!signal.aborted) this.#tell(error);
    } finally {
      if (this.#loading === loading) this.#loading = null;
    }
  }

  /**
   * The file of `image` or `src`.
   *
   * @param {AbortSignal} signal
   */
  async #file(signal) {
    const { image } = this;
    if (image === null) return null;
    if (typeof image !== "string" && !(image instanceof URL)) return fileOf(image);
    const response = await fetch(image, { signal });
    if (!response.ok) throw new Error(`${image}: status ${response.status}`);
    return response.blob();
  }

  /**
   * A session without a picture of the site: its own at rest, and its handles, unless the site has
   * set others.
   *
   * @param {AbortSignal} signal
   */
  async #existing(signal) {
    if (!this.session || this.image !== null || !this.client) return null;
    const session = this.client.session(this.session);
    const object = await session.refresh({ signal });
    const p = /** @type {Page.WireHandle[]} */ (object.p);
    const { blob } = await session.warp({ q: object.p }, { signal });
    if (this.#full.length) return { session: null, blob };
    const q = /** @type {Page.WireHandle[] | undefined} */ (object.q) ?? p;
    const { method, alpha, strength } = object;
    this.warp = { p, q, method, alpha, strength };
    return { session, blob };
  }

  /**
   * @param {Blob} blob
   * @param {import("../../../api/npm/client/index.js").Session | null} session
   */
  #warpBy(blob, session) {
    const { client } = this;
    const stage = this.#stage;
    if (!stage) return;
    const told = {
      problem: (/** @type {unknown} */ error) => this.#tell(error),
      shown: () => {
        if (!this.#isReady) this.#fire("warpready");
        this.#isReady = true;
      },
    };
    const id = this.session || undefined;
    const [store, { view }] = [this.#store, stage];
    this.#warper = client
      ? new Remote(client, id, blob, store, view, told, session)
      : new Local(blob, store, view, told);
  }
}
