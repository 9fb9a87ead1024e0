// The canvas: the part of the posed plane that the result shows. A box is [x, y, width, height], px
// of the picture.

import { find, known, part } from "./dom.js";

/**
 * `same`, `fit` or a box { x, y, width, height }. Documents of older pages lack it.
 * @type {(document: Pick<Page.Document, "canvas">) => Page.Canvas}
 */
export const canvasOf = ({ canvas }) => canvas ?? "same";

/** What is beyond this share of a px is on the next one, as on the server. */
const STEPS = 256;
/** The result counts as cut off from this length on, px. */
const LEAST_CUT = 0.5;

/** @type {(size: Page.Size) => Page.Box} */
export const boxOfPicture = ([width, height]) => [0, 0, width, height];

/**
 * Left, top, right and bottom edge of a posed grid.
 * @param {Page.Mesh} mesh
 * @returns {Page.Box}
 */
export function boundsOf(mesh) {
  /** @type {[left: number, top: number, right: number, bottom: number]} */
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  for (let k = 0; k < mesh.places.length; k += 2) {
    const [x, y] = [mesh.places[k], mesh.places[k + 1]];
    if (x < bounds[0]) bounds[0] = x;
    if (y < bounds[1]) bounds[1] = y;
    if (x > bounds[2]) bounds[2] = x;
    if (y > bounds[3]) bounds[3] = y;
  }
  return bounds;
}

/**
 * The box of a canvas around a posed grid on a picture of this size. `staying`: with the picture
 * itself, of which only a region moves.
 * @param {Page.Canvas} canvas
 * @param {Page.Size} size
 * @param {Page.Mesh | null} mesh
 * @param {boolean} [staying]
 * @returns {Page.Box}
 */
export function boxOf(canvas, size, mesh, staying = false) {
  if (canvas === "same" || !mesh) return boxOfPicture(size);
  if (canvas !== "fit") return [canvas.x, canvas.y, canvas.width, canvas.height];
  const bounds = boundsOf(mesh);
  const whole = staying
    ? [0, 0, ...size].map((edge, k) => (k < 2 ? Math.min : Math.max)(edge, bounds[k]))
    : bounds;
  const [left, top, right, bottom] = whole.map((edge) => Math.round(edge * STEPS) / STEPS);
  const [x, y] = [Math.floor(left), Math.floor(top)];
  return [x, y, Math.max(1, Math.ceil(right) - x), Math.max(1, Math.ceil(bottom) - y)];
}

/**
 * The box that a response names: the header `Warp-Canvas`, or `canvas` in the report of a frame;
 * null where it is that of the picture.
 * @param {string | Page.CanvasBox | null | undefined} told
 * @returns {Page.Box | null}
 */
export function boxFrom(told) {
  if (!told) return null;
  if (typeof told === "string") return /** @type {Page.Box} */ (told.split(",").map(Number));
  return [told.x, told.y, told.width, told.height];
}

/**
 * How far a posed grid extends beyond a box: { left, top, right, bottom }, px, 0 where it does not.
 * @param {Page.Mesh} mesh
 * @param {Page.Box} box
 */
export function cutOff(mesh, [x, y, width, height]) {
  const [left, top, right, bottom] = boundsOf(mesh);
  /** @type {(length: number) => number} */
  const far = (length) => (length >= LEAST_CUT ? Math.ceil(length) : 0);
  return {
    left: far(x - left),
    top: far(y - top),
    right: far(right - x - width),
    bottom: far(bottom - y - height),
  };
}

/**
 * The outlines of the picture and of the canvas, with the coordinates of its edges, over the stage.
 */
export class CanvasRuler {
  /**
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Page.Sync} sync
   */
  constructor(store, view, sync) {
    this.store = store;
    this.view = view;
    this.ruler = find("ruler");
    this.frame = find("source-frame");
    store.subscribe(() => this.draw());
    view.subscribe(() => this.draw());
    sync.subscribe(() => this.draw());
  }

  draw() {
    const { picture, document: bent, phase } = this.store.state;
    const shown = phase === "open" && picture && this.view.size && canvasOf(bent) !== "same";
    this.ruler.hidden = this.frame.hidden = !shown;
    if (!shown) return;
    const box = this.view.box;
    this.#place(this.ruler, box);
    this.#place(this.frame, boxOfPicture(known(this.view.size)));
    const [x, y, width, height] = box;
    const edges = { left: x, right: x + width, top: y, bottom: y + height };
    for (const [side, at] of Object.entries(edges))
      part(this.ruler, `[data-edge=${side}]`).textContent = String(at);
  }

  /**
   * @param {HTMLElement} element
   * @param {Page.Box} box
   */
  #place({ style }, [x, y, width, height]) {
    const [left, top] = this.view.toStage([x, y]);
    style.transform = `translate(${left}px, ${top}px)`;
    style.width = `${width * this.view.zoom}px`;
    style.height = `${height * this.view.zoom}px`;
  }
}
