// The table of handles: every coordinate of p and q can be edited.

import { known } from "./dom.js";
import { kindName, withDepth, withNumber } from "./edits.js";
import { angleOf } from "./twist.js";
import { marked } from "./words.js";

/**
 * The number of an input; null: a pin that is not twisted, or a depth of 0.
 * @type {(handle: Page.Handle, vertex: number, input: HTMLInputElement) => number | null}
 */
const valueOf = (handle, vertex, { dataset }) =>
  dataset.which === "p" || dataset.which === "q"
    ? handle[dataset.which][vertex][Number(dataset.axis)]
    : dataset.which === "depth"
      ? (handle.depth ?? null)
      : angleOf(handle);

/** What the rows depend on. */
const SHOWN = /** @type {const} */ (["document", "selection", "problem", "apart"]);

/** @type {(target: EventTarget | null) => target is HTMLInputElement} */
const isInput = (target) => target instanceof HTMLInputElement;

export class Table {
  /** @type {string | null} */
  #shape = null;
  /**
   * The state that the rows show.
   *
   * @type {Pick<Page.State, (typeof SHOWN)[number]> | null}
   */
  #filled = null;
  /**
   * What is filled, in order: looking for it takes longer than the rest of a frame's script.
   *
   * @type {{ row: HTMLTableRowElement, index: number, vertex: number, inputs: HTMLInputElement[] }[]}
   */
  #rows = [];
  #body;

  /**
   * @param {HTMLTableElement} table
   * @param {Page.Store} store
   * @param {Page.UserActions} actions
   */
  constructor(table, store, actions) {
    this.table = table;
    this.store = store;
    this.actions = actions;
    this.#body = table.tBodies[0];
    table.addEventListener("change", ({ target }) => isInput(target) && this.#changed(target));
    table.addEventListener("focusin", ({ target }) => isInput(target) && this.#entered(target));
    table.addEventListener("focusout", () => this.#fill(this.store.state));
    table.addEventListener(
      "keydown",
      ({ key, target }) => key === "Enter" && isInput(target) && this.#changed(target),
    );
    store.subscribe((state) => this.#draw(state));
  }

  /** @param {Page.State} state */
  #draw(state) {
    const shape = state.document.handles.map((h) => `${h.id}:${h.p.length}`).join();
    if (shape !== this.#shape) this.#build(state.document, shape);
    else {
      const filled = this.#filled;
      const others = filled ? SHOWN.filter((name) => state[name] !== filled[name]) : SHOWN;
      if (!others.length) return;
      if (filled && others.join() === "document") return this.#fill(state, filled.document.handles);
    }
    this.#fill(state);
  }

  /**
   * @param {Page.Document} document
   * @param {string} shape
   */
  #build(document, shape) {
    this.#shape = shape;
    this.#rows = document.handles.flatMap((handle, index) =>
      handle.p.map((_, vertex) => {
        const row = this.#row(handle, index, vertex);
        return { row, index, vertex, inputs: [...row.querySelectorAll("input")] };
      }),
    );
    this.#body.replaceChildren(...this.#rows.map(({ row }) => row));
    /** @type {HTMLElement} */ (known(this.table.closest(".scroll"))).hidden =
      document.handles.length === 0;
  }

  /**
   * @param {Page.Handle} handle
   * @param {number} index
   * @param {number} vertex
   */
  #row(handle, index, vertex) {
    const row = document.createElement("tr");
    Object.assign(row.dataset, { handle: index, vertex });
    const head = document.createElement("th");
    head.scope = "row";
    const choose = document.createElement("button");
    choose.type = "button";
    const single = handle.p.length === 1;
    choose.textContent = single ? `${index + 1}` : `${index + 1}.${vertex + 1}`;
    choose.setAttribute(
      "aria-label",
      `Select ${kindName(handle).toLowerCase()} ${index + 1}${single ? "" : `.${vertex + 1}`}`,
    );
    choose.addEventListener("click", (event) =>
      this.actions.choose(
        { handle: this.store.state.document.handles[index], vertex: single ? null : vertex },
        event.shiftKey,
      ),
    );
    head.append(choose);
    row.append(head);
    /** @type {(input: HTMLInputElement) => void} */
    const cell = (input) => {
      const made = document.createElement("td");
      made.append(input);
      row.append(made);
    };
    for (const which of /** @type {const} */ (["p", "q"])) {
      for (const axis of [0, 1]) {
        const input = document.createElement("input");
        Object.assign(input, {
          type: "number",
          step: "any",
          id: `${which}-${index}-${vertex}-${"xy"[axis]}`,
        });
        Object.assign(input.dataset, { which, axis });
        const place = single ? "" : ` point ${vertex + 1}`;
        input.setAttribute(
          "aria-label",
          `Handle ${index + 1}${place} ${which === "p" ? "rest" : "posed"} ${"xy"[axis]}`,
        );
        cell(input);
      }
    }
    if (single) {
      const input = document.createElement("input");
      Object.assign(input, {
        type: "number",
        step: "any",
        min: -180,
        max: 180,
        id: `twist-${index}`,
      });
      input.dataset.which = "twist";
      input.setAttribute("aria-label", `Handle ${index + 1} twist, degrees`);
      cell(input);
    } else row.append(document.createElement("td"));
    if (vertex === 0) {
      const input = document.createElement("input");
      Object.assign(input, { type: "number", step: "any", min: -1000, max: 1000 });
      input.id = `depth-${index}`;
      input.dataset.which = "depth";
      input.setAttribute("aria-label", `Handle ${index + 1} depth`);
      cell(input);
    }
    return row;
  }

  /**
   * Fills the rows. `before`: the handles that they show; the rows of those that are still there are
   * left as they are, which during a drag are most.
   * @param {Page.State} state
   * @param {Page.Handle[]} [before]
   */
  #fill(state, before = []) {
    const { document, selection, problem, apart } = state;
    this.#filled = { document, selection, problem, apart };
    const marks = [...marked(problem), ...apart];
    for (const { row, index, vertex, inputs } of this.#rows) {
      const handle = document.handles[index];
      if (handle === before[index]) continue;
      row.classList.toggle(
        "selected",
        selection.includes(String(handle.id)) || selection.includes(`${handle.id}.${vertex}`),
      );
      row.toggleAttribute("data-fault", marks.includes(index));
      for (const input of inputs) {
        const value = valueOf(handle, vertex, input);
        // Rounded, so that it fits the cell; in full while it is edited.
        const words =
          value === null
            ? ""
            : String(
                input === globalThis.document.activeElement ? value : Math.round(value * 10) / 10,
              );
        if (input.value !== words) input.value = words;
      }
    }
  }

  /** @param {HTMLElement} row */
  #where(row) {
    return { index: Number(row.dataset.handle), vertex: Number(row.dataset.vertex) };
  }

  /** @param {HTMLInputElement} input */
  #changed(input) {
    const { index, vertex } = this.#where(known(input.closest("tr")));
    const { document } = this.store.state;
    const value = input.value.trim() === "" ? NaN : Number(input.value);
    const { which, axis } = input.dataset;
    if (which === "depth")
      this.actions.edit(withDepth(document, index, Number.isFinite(value) ? value : 0));
    else if (which !== "p" && which !== "q")
      this.actions.twistTo(index, Number.isFinite(value) ? value : null);
    else if (Number.isFinite(value))
      this.actions.edit(withNumber(document, which, index, vertex, Number(axis), value));
    // Show the accepted value: the input may have been rejected or rounded.
    this.#fill(this.store.state);
  }

  /**
   * Selects the handle of the focused input.
   * @param {HTMLInputElement} input
   */
  #entered(input) {
    const { index, vertex } = this.#where(known(input.closest("tr")));
    const handle = this.store.state.document.handles[index];
    const value = valueOf(handle, vertex, input);
    if (value !== null) input.value = String(value);
    input.select();
    const key = handle.p.length === 1 ? String(handle.id) : `${handle.id}.${vertex}`;
    const { selection } = this.store.state;
    if (!selection.includes(key) && !selection.includes(String(handle.id)))
      this.store.do("select", { keys: [key] });
  }
}
