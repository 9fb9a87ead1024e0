// The slider from the rest pose to the full pose, and beyond both.

import { atStrength, shownStrength } from "./strength.js";

/** With a pointer, a value this close to the rest pose or the full pose becomes it. */
const SNAP = 0.03;

export class StrengthSlider {
  #held = false;

  /**
   * @param {HTMLInputElement} input
   * @param {HTMLElement} output
   * @param {Page.Store} store
   * @param {Page.UserActions} actions
   */
  constructor(input, output, store, actions) {
    this.input = input;
    this.output = output;
    this.store = store;
    this.actions = actions;
    input.addEventListener("pointerdown", () => (this.#held = true));
    input.addEventListener("input", () => this.#slide());
    input.addEventListener("change", () => this.#end());
    for (const name of ["pointerup", "pointercancel", "blur"])
      input.addEventListener(name, () => this.#end());
    store.subscribe(
      (state, previous) =>
        (state.document !== previous.document || state.playing !== previous.playing) &&
        this.#draw(),
    );
    this.#draw();
  }

  /** With a pointer like a drag: one undo step. With the keyboard, quick presses are one step. */
  #slide() {
    const { state } = this.store;
    const value = Number(this.input.value);
    const t = this.#held ? ([0, 1].find((end) => Math.abs(value - end) <= SNAP) ?? value) : value;
    const document = atStrength(state.document, t);
    if (!this.#held) this.actions.edit(document, { tag: "strength" });
    else {
      if (!state.before) this.store.do("dragBegin");
      this.store.do("drag", { document });
    }
    this.#draw();
  }

  #end() {
    if (this.#held && this.store.state.before) this.store.do("dragEnd");
    this.#held = false;
    this.#draw();
  }

  #draw() {
    const { state } = this.store;
    const t = shownStrength(state);
    const words = `${Math.round(100 * t)} %`;
    if (Number(this.input.value) !== t) this.input.value = String(t);
    this.input.disabled = !state.document.handles.length;
    const note = t === 0 ? ", rest" : t === 1 ? ", your pose" : "";
    this.input.setAttribute("aria-valuetext", `${words}${note}`);
    if (this.output.textContent !== words) this.output.textContent = words;
  }
}
