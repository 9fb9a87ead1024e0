// The tools for the region: its overlay, the brush under the pointer, and the controls. Everything
// is drawn on the picture at rest.

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

const find = (id) => document.getElementById(id);
const text = (id, words) => find(id).textContent !== words && (find(id).textContent = words);

export class RegionTool {
  #mask = null; // of the shown region; null: the whole picture moves
  #shown = { parts: [], feather: 0 };
  #size = null;
  #places = []; // of the stroke that is being drawn
  #brushAt = null; // position of the stage
  #due = false;

  constructor(store, view, actions) {
    Object.assign(this, {
      store,
      view,
      actions,
      context: find("region").getContext("2d", { willReadFrequently: true }),
    });
    const show = (what) => store.do("show", { what });
    find("region-adds").addEventListener("change", () => show({ removes: false }));
    find("region-removes").addEventListener("change", () => show({ removes: true }));
    find("brush-size").addEventListener("input", ({ target }) =>
      show({ brush: Number(target.value) }),
    );
    find("region-shown").addEventListener("change", ({ target }) =>
      show({ regionShown: target.checked }),
    );
    find("feather").addEventListener("input", ({ target }) =>
      this.#set({ feather: Number(target.value) }, "feather"),
    );
    find("holes").addEventListener("change", ({ target }) => this.#set({ holes: target.value }));
    find("region-invert").addEventListener("click", () => actions.invertRegion());
    find("region-clear").addEventListener("click", () => actions.clearRegion());
    store.subscribe((state, previous) => this.#follow(state, previous));
    this.#drawControls(store.state);
  }

  #set(what, tag = "") {
    this.actions.edit({ ...this.store.state.document, ...what }, { tag });
  }

  #follow(state, previous) {
    const { document, picture } = state;
    const region = regionOf(document);
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
    return Math.min(1, Math.sqrt(PIXELS / (this.#size[0] * this.#size[1])));
  }

  /** Shows the stroke that is being drawn. */
  draw(places) {
    this.#places = places;
    this.#invalidate();
  }

  /** Shows the size of the brush at a position of the stage; null hides it. */
  hover(at) {
    const { tool, playing } = this.store.state;
    this.#brushAt = at;
    const node = find("brush-at");
    node.hidden = !at || tool !== "brush" || playing !== null;
    if (node.hidden) return;
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
    const seen =
      this.#size &&
      state.phase === "open" &&
      state.regionShown &&
      !state.compare &&
      !state.peek &&
      state.playing === null;
    const { canvas } = this.context;
    canvas.hidden = !seen || (!this.#mask && !this.#places.length);
    if (canvas.hidden) return;
    const [width, height] = this.#size.map((side) => Math.max(1, Math.round(side * this.#scale)));
    Object.assign(canvas, { width, height });
    const whole = () =>
      maskOf(
        { parts: part?.removes || !part ? [{ kind: "invert" }] : [], feather: 0 },
        this.#size,
        this.#scale,
      );
    const mask = this.#mask ?? whole();
    const { context } = this;
    context.fillStyle = SHADE;
    context.fillRect(0, 0, width, height);
    context.globalCompositeOperation = "destination-out";
    context.drawImage(part ? withStroke(mask, part, this.#size) : mask, 0, 0);
    context.globalCompositeOperation = "source-over";
    if (state.tool === "lasso") this.#paintLine(width / this.#size[0]);
  }

  /** The line of the lasso. */
  #paintLine(scale) {
    const { context } = this;
    context.beginPath();
    for (const [x, y] of this.#places) context.lineTo(x * scale, y * scale);
    for (const [colour, wide] of [
      ["#000a", 4],
      ["#fff", 2],
    ]) {
      Object.assign(context, {
        strokeStyle: colour,
        lineWidth: (wide * scale) / this.view.zoom,
        lineJoin: "round",
      });
      context.stroke();
    }
  }

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
    if (picture) find("brush-size").max = Math.round(Math.max(picture.width, picture.height) / 2);
    find("brush-size").value = brushSizeOf(state);
    text("brush-size-value", `${brushSizeOf(state)} px`);
    text("region-note", parts.length ? REGION.some : REGION.none);
    find("feather").value = feather;
    find("feather").setAttribute("aria-valuetext", `${feather} px`);
    text("feather-value", `${feather} px`);
    find("region-shown").checked = regionShown;
    find("holes").value = holesOf(document);
    text("holes-note", HOLES[holesOf(document)]);
    for (const id of ["feather", "holes", "region-shown", "region-invert", "region-clear"])
      find(id).disabled = !parts.length;
  }
}
