// The tools for the region: its overlay, the brush under the pointer, and the controls. Everything
// is drawn on the picture at rest.

import { contextOf, find, known, listen, text } from "./dom.js";
import {
  decodeParts,
  brushSizeOf,
  isDecoded,
  isRegionTool,
  maskOf,
  partOf,
  regionOf,
  sameRegion,
  withStroke,
} from "./region.js";
import { holesOf } from "./edits.js";
import { HOLES, REGION } from "./words.js";

/**
 * Most pixels of the mask on the screen and in the live preview; the server gets one of the
 * picture's size.
 */
const PIXELS = 1.5e6;
/** What covers the part that stays. */
const SHADE = "rgb(30 50 160 / .5)";

export class RegionTool {
  /** @type {HTMLCanvasElement | null} */
  #mask = null; // of the shown region; null: the whole picture moves
  /** @type {Page.Region} */
  #shown = { parts: [], feather: 0 };
  /** @type {Page.Size | null} */
  #size = null;
  /** @type {Page.Place[]} */
  #places = []; // of the stroke that is being drawn
  /** @type {Page.Place | null} */
  #brushAt = null; // position of the stage
  #due = false;

  /**
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Page.UserActions} actions
   */
  constructor(store, view, actions) {
    this.store = store;
    this.view = view;
    this.actions = actions;
    this.context = contextOf(find("region"), { willReadFrequently: true });
    /** @type {(what: Partial<Page.State>) => void} */
    const show = (what) => store.do("show", { what });
    find("region-adds").addEventListener("change", () => show({ removes: false }));
    find("region-removes").addEventListener("change", () => show({ removes: true }));
    listen("brush-size", "input", ({ value }) => show({ brush: Number(value) }));
    listen("region-shown", "change", ({ checked }) => show({ regionShown: checked }));
    listen("feather", "input", ({ value }) => this.#set({ feather: Number(value) }, "feather"));
    listen("holes", "change", ({ value }) =>
      this.#set({ holes: /** @type {Page.Holes} */ (value) }),
    );
    find("region-invert").addEventListener("click", () => actions.invertRegion());
    find("region-clear").addEventListener("click", () => actions.clearRegion());
    store.subscribe((state, previous) => this.#follow(state, previous));
    this.#drawControls(store.state);
  }

  /**
   * @param {Partial<Page.Document>} what
   * @param {string} [tag]
   */
  #set(what, tag = "") {
    this.actions.edit({ ...this.store.state.document, ...what }, { tag });
  }

  /**
   * @param {Page.State} state
   * @param {Page.State} previous
   */
  #follow(state, previous) {
    const { document, picture } = state;
    const region = regionOf(document);
    /** @type {Page.Size | null} */
    const size = picture && [picture.width, picture.height];
    const isOther = !sameRegion(region, this.#shown) || String(size) !== String(this.#size);
    if (isOther) this.#take(region, size);
    if (isOther || holesOf(document) !== holesOf(previous.document))
      this.view.setRegion(this.#mask, holesOf(document));
    this.#drawControls(state);
    this.#invalidate();
    if (state.tool !== "brush") this.hover(null);
    else if (state.cross !== previous.cross)
      this.hover(state.cross && this.view.toStage(state.cross));
    else if (state.brush !== previous.brush || state.playing !== previous.playing)
      this.hover(this.#brushAt);
  }

  /**
   * @param {Page.Region} region
   * @param {Page.Size | null} size
   */
  #take(region, size) {
    this.#shown = region;
    this.#size = size;
    this.#mask = null;
    if (!size || !region.parts.length) return;
    if (isDecoded(region.parts)) this.#mask = maskOf(region, size, this.#scale);
    else decodeParts(region.parts).then(() => this.#shown === region && this.#again());
  }

  #again() {
    this.#take(this.#shown, this.#size);
    this.view.setRegion(this.#mask, holesOf(this.store.state.document));
    this.#invalidate();
  }

  get #scale() {
    const [width, height] = known(this.#size);
    return Math.min(1, Math.sqrt(PIXELS / (width * height)));
  }

  /**
   * Shows the stroke that is being drawn.
   * @param {Page.Place[]} places
   */
  draw(places) {
    this.#places = places;
    this.#invalidate();
  }

  /**
   * Shows the size of the brush at a position of the stage; null hides it.
   * @param {Page.Place | null} at
   */
  hover(at) {
    const { tool, playing } = this.store.state;
    this.#brushAt = at;
    const node = find("brush-at");
    node.hidden = !at || tool !== "brush" || playing !== null;
    if (!at || node.hidden) return;
    const side = brushSizeOf(this.store.state) * this.view.zoom;
    Object.assign(node.style, {
      width: `${side}px`,
      height: `${side}px`,
      transform: `translate(${at[0] - side / 2}px, ${at[1] - side / 2}px)`,
    });
  }

  #invalidate() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#paint();
    });
  }

  /** Covers what stays, with the stroke that is being drawn. */
  #paint() {
    const { state } = this.store;
    const part =
      this.#places.length && isRegionTool(state.tool) ? partOf(state, this.#places) : null;
    const size = this.#size;
    const seen =
      state.phase === "open" &&
      state.regionShown &&
      !state.compare &&
      !state.peek &&
      state.playing === null;
    const { canvas } = this.context;
    canvas.hidden = !size || !seen || (!this.#mask && !this.#places.length);
    if (!size || canvas.hidden) return;
    const [width, height] = size.map((side) => Math.max(1, Math.round(side * this.#scale)));
    Object.assign(canvas, { width, height });
    const whole = () =>
      maskOf(
        { parts: part?.removes || !part ? [{ kind: "invert" }] : [], feather: 0 },
        size,
        this.#scale,
      );
    const mask = this.#mask ?? whole();
    const { context } = this;
    context.fillStyle = SHADE;
    context.fillRect(0, 0, width, height);
    context.globalCompositeOperation = "destination-out";
    context.drawImage(part ? withStroke(mask, part, size) : mask, 0, 0);
    context.globalCompositeOperation = "source-over";
    if (state.tool === "lasso") this.#paintLine(width / size[0]);
  }

  /**
   * The line of the lasso.
   * @param {number} scale
   */
  #paintLine(scale) {
    const { context } = this;
    context.beginPath();
    for (const [x, y] of this.#places) context.lineTo(x * scale, y * scale);
    for (const [colour, wide] of /** @type {const} */ ([
      ["#000a", 4],
      ["#fff", 2],
    ])) {
      Object.assign(context, {
        strokeStyle: colour,
        lineWidth: (wide * scale) / this.view.zoom,
        lineJoin: "round",
      });
      context.stroke();
    }
  }

  /** @param {Page.State} state */
  #drawControls(state) {
    const { document, tool, removes, regionShown, picture } = state;
    const { parts, feather } = regionOf(document);
    find(removes ? "region-removes" : "region-adds").checked = true;
    find("region-bar").hidden =
      !isRegionTool(tool) ||
      state.phase !== "open" ||
      state.draft.length > 0 ||
      state.playing !== null;
    find("brush-row").hidden = tool !== "brush";
    if (picture)
      find("brush-size").max = String(Math.round(Math.max(picture.width, picture.height) / 2));
    find("brush-size").value = String(brushSizeOf(state));
    text("brush-size-value", `${brushSizeOf(state)} px`);
    text("region-note", parts.length ? REGION.some : REGION.none);
    find("feather").value = String(feather);
    find("feather").setAttribute("aria-valuetext", `${feather} px`);
    text("feather-value", `${feather} px`);
    find("region-shown").checked = regionShown;
    find("holes").value = holesOf(document);
    text("holes-note", HOLES[holesOf(document)]);
    for (const id of /** @type {const} */ ([
      "feather",
      "holes",
      "region-shown",
      "region-invert",
      "region-clear",
    ]))
      find(id).disabled = !parts.length;
  }
}
