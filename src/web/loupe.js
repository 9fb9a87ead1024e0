// The magnifier: while a finger or a pen drags a handle, a round enlarged view of the place under
// it, with a cross at the handle.

import { contextOf } from "./dom.js";

/** Diameter, distance from the finger, and distance from the edges of the stage, CSS px. */
const SIZE = 128;
const OFF = 104;
const INSET = 8;
const FACTOR = 2.5;

export class Loupe {
  /** @type {Page.Place | null} */
  #at = null; // the shown position, stage px
  /** @type {Page.Place | null} */
  #spot = null; // the same in the picture

  /**
   * `wanted`: whether the user wants it.
   * @param {HTMLCanvasElement} canvas
   * @param {Page.View} view
   * @param {() => boolean} wanted
   */
  constructor(canvas, view, wanted) {
    this.canvas = canvas;
    this.view = view;
    this.wanted = wanted;
    this.context = contextOf(canvas);
    view.afterDraw(() => this.#draw());
  }

  /**
   * Shows the surroundings of a posed position, while the finger is at a position of the stage.
   * @param {Page.Place} place
   * @param {Page.Place} finger
   * @param {string} kind
   */
  show(place, finger, kind) {
    if (kind === "mouse" || !this.wanted()) return;
    const begins = !this.#at;
    this.#spot = place;
    this.#at = this.#beside(finger);
    this.canvas.style.transform = `translate(${this.#at[0]}px, ${this.#at[1]}px)`;
    if (!begins) return;
    const side = Math.round(SIZE * this.view.scale);
    Object.assign(this.canvas, { width: side, height: side });
    this.canvas.hidden = false;
    this.view.invalidate();
  }

  hide() {
    if (!this.#at) return;
    this.#at = this.#spot = null;
    this.canvas.hidden = true;
  }

  /**
   * The upper left corner: above the finger or, near the upper edge, beside it.
   * @param {Page.Place} finger
   * @returns {Page.Place}
   */
  #beside([x, y]) {
    const [width, height] = this.view.stageSize;
    /** @type {(c: number, side: number) => number} */
    const keep = (c, side) => Math.min(side - SIZE - INSET, Math.max(INSET, c));
    const top = y - OFF - SIZE / 2;
    if (top >= INSET) return [keep(x - SIZE / 2, width), top];
    const aside = x + OFF + SIZE / 2 + INSET <= width ? x + OFF : x - OFF;
    return [keep(aside - SIZE / 2, width), keep(y - SIZE / 2, height)];
  }

  /** Called after each frame of the view: the picture is copied from what is drawn already. */
  #draw() {
    if (!this.#spot) return;
    const { context, view } = this;
    const side = context.canvas.width;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, side, side);
    const around = SIZE / FACTOR;
    const [x, y] = view.toStage(this.#spot).map((c) => c - around / 2);
    view.copyTo(context, [x, y, around, around], side);
    const middle = side / 2;
    const arm = 11 * view.scale;
    context.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [0, 1],
    ]) {
      context.moveTo(middle - arm * dx, middle - arm * dy);
      context.lineTo(middle + arm * dx, middle + arm * dy);
    }
    for (const [colour, wide] of /** @type {const} */ ([
      ["rgb(0 0 0 / 0.65)", 3.5],
      ["#fff", 1.5],
    ])) {
      context.strokeStyle = colour;
      context.lineWidth = wide * view.scale;
      context.stroke();
    }
  }
}
