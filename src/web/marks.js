// Handles on a canvas, below the SVG: hundreds of SVG elements take longer to draw than a frame
// may, and so does an SVG of which anything changes, without a graphics card. The SVG keeps an
// element of each handle for focus, names and pointers, and draws the few that are selected,
// hovered, focused or faulty. During a drag it is transparent, and the canvas shows these too.
// Those that are not selected are drawn once.

import { contextOf } from "./dom.js";

/** Up to this many selected handles are drawn by the SVG. */
export const FEW_SELECTED = 50;
/** A handle that is nearer to its rest position has no line to it, CSS px. */
export const LEAST_WAY = 4;
/** Length of the stalk between a ring and its knob, and radius of the knob, CSS px. */
export const STALK = 16;
export const PLATE = 10.5;
/** Space around the places of what moves, for dots and numbers, CSS px. */
const EDGE = 40;
const FONT =
  '650 12px ui-sans-serif, system-ui, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif';
const SHADE = "rgb(0 0 0 / .38)";
/** @type {Record<string, string>} */
const FAULTS = { "": "#ff2d4b", warning: "#ffb020" };
/** The round arrow of the ring, as in the SVG. */
const ARROW = "M4.6-5.2A7 7 0 1 0 7 0M7.4-8.6 5-5 1-6";

/** @type {(a: unknown[], b: unknown[]) => boolean} */
const near = (a, b) => a.length === b.length && a.every((part, k) => part === b[k]);

const PARTS = /** @type {const} */ (["handles", "looks", "place"]);

/**
 * @typedef {{ handle: Page.Handle } & Partial<Page.Mark> & Pick<Page.Mark, "pressed">} MarkedHandle
 */

export class Marks {
  /**
   * What the lower canvas shows: the handles, their looks, and the place of the view.
   *
   * @type {Record<(typeof PARTS)[number], unknown[]> | null}
   */
  #drawn = null;

  /**
   * `upper`: a canvas of what moves, only as large as that.
   * @param {HTMLCanvasElement} lower
   * @param {HTMLCanvasElement} upper
   * @param {Page.View} view
   */
  constructor(lower, upper, view) {
    const often = { willReadFrequently: true };
    this.view = view;
    this.lower = contextOf(lower, often);
    this.upper = contextOf(upper, often);
    this.colour = "#1a6dff";
    /** Of a point, CSS px. */
    this.radius = 7;
    /** The one that is being drawn. */
    this.context = this.lower;
  }

  /**
   * Draws handles: `plain` ones, and those `moving` in a drag over them, as { handle, pressed,
   * fault, labels }; `ring` as in `Handles.ringAt`, with `degrees`.
   * @param {MarkedHandle[]} plain
   * @param {MarkedHandle[] | null} moving
   * @param {Page.Ring & { degrees: string } | null} ring
   * @param {boolean} isHidden
   */
  draw(plain, moving, ring, isHidden) {
    const { canvas } = this.lower;
    canvas.hidden = isHidden || !this.view.size;
    const moves = moving !== null && (moving.length > 0 || ring !== null);
    this.upper.canvas.hidden = canvas.hidden || !moves;
    if (canvas.hidden) return;
    this.#drawStill(plain);
    if (moving && moves) this.#drawMoving(moving, ring);
  }

  /** @param {MarkedHandle[]} plain */
  #drawStill(plain) {
    const { zoom, pan, stageSize, scale } = this.view;
    const now = {
      handles: plain.map(({ handle }) => handle),
      looks: plain.map(({ pressed }) => String(pressed)),
      place: [zoom, ...pan, ...stageSize, scale],
    };
    const drawn = this.#drawn;
    if (drawn && PARTS.every((part) => near(drawn[part], now[part]))) return;
    this.#drawn = now;
    const style = getComputedStyle(this.lower.canvas);
    this.colour = style.getPropertyValue("--handle") || this.colour;
    this.radius = parseFloat(style.getPropertyValue("--handle-size")) / 2 || this.radius;
    this.#begin(this.lower, [0, 0, ...stageSize]);
    // Their numbers are those of the SVG.
    this.#drawAll(plain.map(({ handle, pressed }) => ({ handle, pressed })));
  }

  /**
   * @param {MarkedHandle[]} moving
   * @param {Page.Ring & { degrees: string } | null} ring
   */
  #drawMoving(moving, ring) {
    const { view } = this;
    const places = moving.flatMap(({ handle: { p, q } }) =>
      [...p, ...q].map((at) => view.toStage(at)),
    );
    if (ring)
      places.push(
        ...[-1, 1].map((side) => ring.middle.map((c) => c + side * (ring.r + STALK))),
        ring.knob,
      );
    /** @type {(which: (...numbers: number[]) => number, axis: number) => number} */
    const edge = (which, axis) =>
      places.reduce((most, at) => which(most, at[axis]), places[0][axis]);
    const low = [0, 1].map((axis) => Math.max(0, Math.floor(edge(Math.min, axis) - EDGE)));
    const high = [0, 1].map((axis) =>
      Math.min(view.stageSize[axis], Math.ceil(edge(Math.max, axis) + EDGE)),
    );
    const size = [0, 1].map((axis) => Math.max(1, high[axis] - low[axis]));
    this.#begin(this.upper, [low[0], low[1], size[0], size[1]]);
    this.#drawAll(moving);
    if (ring) this.#drawRing(ring);
  }

  /**
   * Prepares a canvas that covers a box of the stage.
   * @param {CanvasRenderingContext2D} context
   * @param {Page.Box} box
   */
  #begin(context, [left, top, width, height]) {
    const { scale } = this.view;
    this.context = context;
    Object.assign(context.canvas, {
      width: Math.max(1, Math.round(width * scale)),
      height: Math.max(1, Math.round(height * scale)),
    });
    Object.assign(context.canvas.style, {
      width: `${width}px`,
      height: `${height}px`,
      transform: `translate(${left}px, ${top}px)`,
    });
    context.scale(scale, scale);
    context.translate(-left, -top);
    Object.assign(context, {
      lineCap: "round",
      lineJoin: "round",
      textAlign: "center",
      font: FONT,
    });
  }

  /** @param {MarkedHandle[]} marks */
  #drawAll(marks) {
    const posed = marks.map(({ handle }) => handle.q.map((at) => this.view.toStage(at)));
    this.#drawGhosts(
      marks.map(({ handle }) => handle),
      posed,
    );
    marks.forEach((mark, k) => this.#drawHandle(posed[k], mark));
  }

  /**
   * From where handles rest to where they are.
   * @param {Page.Handle[]} handles
   * @param {Page.Place[][]} posed
   */
  #drawGhosts(handles, posed) {
    const { context, view } = this;
    /** @type {[Page.Place, Page.Place][]} */
    const ways = handles.flatMap(({ p }, k) => p.map((at, n) => [view.toStage(at), posed[k][n]]));
    const far = ways.filter(([[x, y], [a, b]]) => Math.hypot(a - x, b - y) > LEAST_WAY);
    context.beginPath();
    for (const [from, to] of far) {
      context.moveTo(...from);
      context.lineTo(...to);
    }
    this.#stroke("rgb(0 0 0 / .35)", 2.5);
    context.setLineDash([3, 4]);
    this.#stroke("#fff", 1.5);
    context.setLineDash([]);
    context.beginPath();
    for (const [[x, y]] of far) {
      context.moveTo(x + 3.2, y);
      context.arc(x, y, 3.2, 0, 2 * Math.PI);
    }
    this.#fill("rgb(255 255 255 / .9)");
    this.#stroke("rgb(0 0 0 / .63)", 1.2);
  }

  /**
   * @param {Page.Place[]} places
   * @param {MarkedHandle} mark
   */
  #drawHandle(places, { pressed, fault = null, labels = [] }) {
    const { context } = this;
    const isLine = places.length > 1;
    const colour = fault === null ? this.colour : FAULTS[fault];
    if (isLine) {
      context.beginPath();
      for (const at of places) context.lineTo(...at);
      this.#stroke(SHADE, 6.5);
      this.#stroke("#fff", 4.5);
      this.#stroke(colour, pressed.every(Boolean) ? 3 : 2);
    }
    places.forEach(([x, y], k) => {
      /** @type {(half: number, round: number, r: number) => void} */
      const shape = (half, round, r) => {
        context.beginPath();
        if (isLine) context.roundRect(x - half, y - half, 2 * half, 2 * half, round);
        else context.arc(x, y, r, 0, 2 * Math.PI);
      };
      const half = (5 / 7) * this.radius;
      shape(half + 2.5, 5, this.radius + 2.5);
      this.#fill(SHADE);
      shape(half, 3, this.radius);
      const isWhite = pressed[k] && fault === null;
      this.#fill(isWhite ? "#fff" : colour);
      this.#stroke(isWhite ? this.colour : "#fff", isWhite ? 4 : 2.5);
      if (labels[k]) this.#write(labels[k], x, y - 15);
    });
  }

  /** @param {Page.Ring & { degrees: string }} ring */
  #drawRing({ middle: [x, y], r, knob: [a, b], degrees }) {
    const { context } = this;
    context.beginPath();
    context.arc(x, y, r, 0, 2 * Math.PI);
    this.#stroke("rgb(0 0 0 / .45)", 3);
    context.setLineDash([5, 5]);
    this.#stroke("#fff", 1.5);
    context.setLineDash([]);
    const [dx, dy] = [x - a, y - b].map((c) => c / Math.hypot(x - a, y - b));
    context.beginPath();
    context.moveTo(a + PLATE * dx, b + PLATE * dy);
    context.lineTo(a + STALK * dx, b + STALK * dy);
    this.#stroke("#fff", 1.5);
    context.beginPath();
    context.arc(a, b, PLATE, 0, 2 * Math.PI);
    this.#fill("rgb(20 21 24 / .72)");
    context.translate(a, b);
    const arrow = new Path2D(ARROW);
    for (const [colour, width] of [
      ["rgb(0 0 0 / .6)", 4],
      ["#fff", 2],
    ]) {
      Object.assign(context, { strokeStyle: colour, lineWidth: width });
      context.stroke(arrow);
    }
    context.translate(-a, -b);
    if (degrees) this.#write(degrees, a, b - 16);
  }

  /**
   * @param {string} words
   * @param {number} x
   * @param {number} y
   */
  #write(words, x, y) {
    const { context } = this;
    Object.assign(context, { strokeStyle: "rgb(0 0 0 / .75)", lineWidth: 3, fillStyle: "#fff" });
    context.strokeText(words, x, y);
    context.fillText(words, x, y);
  }

  /** @param {string} colour */
  #fill(colour) {
    this.context.fillStyle = colour;
    this.context.fill();
  }

  /**
   * @param {string} colour
   * @param {number} width
   */
  #stroke(colour, width) {
    Object.assign(this.context, { strokeStyle: colour, lineWidth: width });
    this.context.stroke();
  }
}
