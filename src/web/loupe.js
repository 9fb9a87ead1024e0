// The magnifier: while a finger or a pen drags a handle, a round enlarged view of the place under
// it, with a cross at the handle.

/** Diameter, distance from the finger, and distance from the edges of the stage, CSS px. */
const SIZE = 128;
const OFF = 104;
const INSET = 8;
const FACTOR = 2.5;

export class Loupe {
  #at = null; // the shown position, stage px
  #spot = null; // the same in the picture

  /** `wanted`: whether the user wants it. */
  constructor(canvas, view, wanted) {
    Object.assign(this, { canvas, view, wanted });
    this.context = canvas.getContext("2d");
    view.afterDraw(() => this.#draw());
  }

  /** Shows the surroundings of a posed position, while the finger is at a position of the stage. */
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

  /** The upper left corner: above the finger or, near the upper edge, beside it. */
  #beside([x, y]) {
    const [width, height] = this.view.stageSize;
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
    for (const [colour, wide] of [
      ["rgb(0 0 0 / 0.65)", 3.5],
      ["#fff", 1.5],
    ]) {
      context.strokeStyle = colour;
      context.lineWidth = wide * view.scale;
      context.stroke();
    }
  }
}
