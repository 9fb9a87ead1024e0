// The table of handles: every coordinate of p and q can be edited.

import { kindName, withNumber } from "./edits.js";
import { angleOf } from "./twist.js";
import { marked } from "./words.js";

/** The number of an input; null: a pin that is not twisted. */
const valueOf = (handle, vertex, { dataset }) =>
  dataset.which === "twist" ? angleOf(handle) : handle[dataset.which][vertex][Number(dataset.axis)];

export class Table {
  #shape = null;
  #filled = {}; // the state that the rows show
  #body;

  constructor(table, store, actions) {
    Object.assign(this, { table, store, actions });
    this.#body = table.tBodies[0];
    table.addEventListener("change", (event) => this.#changed(event.target));
    table.addEventListener("focusin", (event) => this.#entered(event));
    table.addEventListener("focusout", () => this.#fill(this.store.state));
    table.addEventListener(
      "keydown",
      (event) =>
        event.key === "Enter" && event.target.matches("input") && this.#changed(event.target),
    );
    store.subscribe((state) => this.#draw(state));
  }

  #draw(state) {
    const shape = state.document.handles.map((h) => `${h.id}:${h.p.length}`).join();
    if (shape !== this.#shape) this.#build(state.document, shape);
    else if (
      ["document", "selection", "problem", "apart"].every(
        (name) => state[name] === this.#filled[name],
      )
    )
      return;
    else if (["selection", "problem", "apart"].every((name) => state[name] === this.#filled[name]))
      return this.#fill(state, this.#filled.document.handles);
    this.#fill(state);
  }

  #build(document, shape) {
    this.#shape = shape;
    this.#body.replaceChildren(
      ...document.handles.flatMap((handle, index) =>
        handle.p.map((_, vertex) => this.#row(handle, index, vertex)),
      ),
    );
    this.table.closest(".scroll").hidden = document.handles.length === 0;
  }

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
    const cell = (input) => {
      const made = document.createElement("td");
      made.append(input);
      row.append(made);
    };
    for (const which of ["p", "q"]) {
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
    }
    return row;
  }

  /**
   * Fills the rows, except those whose handle is among the `known` ones: during a drag most are.
   */
  #fill(state, known = []) {
    const { document, selection, problem, apart } = state;
    this.#filled = { document, selection, problem, apart };
    const marks = [...marked(problem), ...apart];
    for (const row of this.#body.rows) {
      const { index, vertex } = this.#where(row);
      const handle = document.handles[index];
      if (handle === known[index]) continue;
      row.classList.toggle(
        "selected",
        selection.includes(String(handle.id)) || selection.includes(`${handle.id}.${vertex}`),
      );
      row.toggleAttribute("data-fault", marks.includes(index));
      for (const input of row.querySelectorAll("input")) {
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

  #where(row) {
    return { index: Number(row.dataset.handle), vertex: Number(row.dataset.vertex) };
  }

  #changed(input) {
    if (!input.matches("input")) return;
    const { index, vertex } = this.#where(input.closest("tr"));
    const { document } = this.store.state;
    const value = input.value.trim() === "" ? NaN : Number(input.value);
    if (input.dataset.which === "twist")
      this.actions.twistTo(index, Number.isFinite(value) ? value : null);
    else if (Number.isFinite(value))
      this.actions.edit(
        withNumber(document, input.dataset.which, index, vertex, Number(input.dataset.axis), value),
      );
    // Show the accepted value: the input may have been rejected or rounded.
    this.#fill(this.store.state);
  }

  /** Selects the handle of the focused input. */
  #entered({ target }) {
    if (!target.matches("input")) return;
    const { index, vertex } = this.#where(target.closest("tr"));
    const handle = this.store.state.document.handles[index];
    const value = valueOf(handle, vertex, target);
    if (value !== null) target.value = value;
    target.select();
    const key = handle.p.length === 1 ? String(handle.id) : `${handle.id}.${vertex}`;
    const { selection } = this.store.state;
    if (!selection.includes(key) && !selection.includes(String(handle.id)))
      this.store.do("select", { keys: [key] });
  }
}
