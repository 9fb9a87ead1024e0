// The controls around the picture: they show the state and change it.

import { alignOf } from "./align.js";
import { boxOf, canvasOf, cutOff } from "./canvas.js";
import { METRIC_PICTURES, methodPicture, offer } from "./choices.js";
import { find, findAll, listen, text } from "./dom.js";
import {
  alphaOf,
  canUnfold,
  filterOf,
  hasFocus,
  hasPinsOnly,
  infoOf,
  kindName,
  kindOfOutside,
  mayHave,
  isOutlined,
  metricOf,
  outsideOf,
  takesLinesOnly,
  takesPinsOnly,
  thresholdOf,
  toolName,
} from "./edits.js";
import { LEAST_PINS } from "./fit.js";
import { METHODS } from "./methods.js";
import { isRegionTool, regionOf } from "./region.js";
import { steps } from "./state.js";
import { canTwist } from "./twist.js";
import {
  ALIGN,
  CANVAS,
  FILTER,
  HINTS,
  METRICS,
  OUTSIDE,
  STAGES,
  WARNINGS,
  bytes,
  count,
  cutWords,
  focusWords,
  foldWords,
  methodWords,
  metricWords,
  noFitWords,
  problemWords,
  waitingWords,
} from "./words.js";

/** @type {(id: keyof PageElements, pressed: boolean) => void} */
const press = (id, pressed) => find(id).setAttribute("aria-pressed", String(pressed));

/** The fields of a box. */
const BOX = /** @type {const} */ (["x", "y", "width", "height"]);

const SIDES = /** @type {const} */ (["left", "right", "up", "down"]);
const TOOLS = /** @type {const} */ (["point", "line", "path", "lasso", "brush"]);

export class Panel {
  #timing = "";
  /**
   * The buttons of the methods, by name.
   * @type {Map<string, HTMLInputElement>}
   */
  #methods = new Map();
  /**
   * Those of the metrics.
   * @type {Map<string, HTMLInputElement>}
   */
  #metrics = new Map();
  /**
   * The canvas that the fields show.
   * @type {Page.Canvas | null}
   */
  #canvas = null;

  /**
   * @param {Page.Store} store
   * @param {Page.Sync} sync
   * @param {Page.View} view
   * @param {Page.UserActions} actions
   * @param {Page.Does} does
   */
  constructor(store, sync, view, actions, does) {
    this.store = store;
    this.sync = sync;
    this.view = view;
    this.actions = actions;
    this.does = does;
    this.#listen();
    store.subscribe((state) => this.#draw(state));
    sync.subscribe(() => this.#drawPicture());
    view.subscribe(() => this.#drawZoom());
    this.#draw(store.state);
  }

  #listen() {
    const { store, view, actions, does } = this;
    /** @type {(id: keyof PageElements, act: () => unknown) => void} */
    const click = (id, act) => find(id).addEventListener("click", act);
    const state = () => store.state;
    click("undo", () => actions.undo(true));
    click("redo", () => actions.undo(false));
    click("open", does.pick);
    click("pick", does.pick);
    click("close", does.close);
    click("export-open", does.export);
    click("open-handles", does.pickHandles);
    click("waiting-drop", () => {
      find("pick").focus({ preventScroll: true }); // this button disappears
      store.do("waiting", { handles: null, annotations: null });
    });
    click("fit", does.fit);
    listen("fit-arrows", "change", ({ checked }) =>
      store.do("show", { what: { fitShown: checked } }),
    );
    click("mesh", does.mesh);
    click("compare", does.compare);
    click("zoom-in", () => view.zoomTo(view.zoom * 1.25));
    click("zoom-out", () => view.zoomTo(view.zoom / 1.25));
    click("zoom-fit", () => view.fit());
    click("zoom-full", does.full);
    for (const [id, dx, dy] of /** @type {const} */ ([
      ["left", 1, 0],
      ["right", -1, 0],
      ["up", 0, 1],
      ["down", 0, -1],
    ])) {
      click(`pan-${id}`, () =>
        view.panBy(...view.stageSize.map((side, axis) => Math.round((side / 3) * [dx, dy][axis]))),
      );
    }
    click("move-to", does.arm);
    click("put-back", () => actions.putBack());
    click("bring-front", () => actions.bring(true));
    click("send-back", () => actions.bring(false));
    click("rotate-left", () => actions.rotate(-5));
    click("rotate-right", () => actions.rotate(5));
    click("select-more", () => store.do("more", { more: !state().more }));
    click("remove", () => actions.remove());
    click("draft-finish", () => actions.finish());
    click("draft-cancel", () => store.do("draft", { places: [] }));
    click("add", () => actions.addInTheMiddle());
    click("pin-border", () => actions.pinBorder());
    click("select-all", () => actions.selectAll());
    click("put-back-all", () => actions.putBack(actions.all));
    click("clear", () => actions.clear());
    click("swap", () => actions.swap());
    listen("align", "change", ({ value }) => actions.align(/** @type {Page.AlignClass} */ (value)));
    click("problem-close", () => store.do("problem", { problem: null }));
    for (const [id, which] of /** @type {const} */ ([
      ["problem-action", "mending"],
      ["problem-other", "alternative"],
    ]))
      click(id, () => {
        const { problem } = state();
        if (problem) does.mend(problem, does[which](problem));
      });
    for (const tool of TOOLS) listen(`tool-${tool}`, "change", () => does.tool(tool));
    for (const method of METHODS) {
      const choose = () => this.#setMethod(method.name);
      const picture = methodPicture(method.name);
      this.#methods.set(method.name, offer("methods", "method", method, picture, choose));
    }
    for (const metric of METRICS) {
      const choose = () => this.#set({ metric: metric.name });
      const picture = METRIC_PICTURES[metric.name];
      this.#metrics.set(metric.name, offer("metrics", "metric", metric, picture, choose));
    }
    listen("threshold", "input", ({ value }) =>
      this.#set({ threshold: Number(value) }, "threshold"),
    );
    listen("grid-size", "change", ({ value }) =>
      this.#set({ grid: value === "auto" ? "auto" : JSON.parse(value) }),
    );
    listen("alpha", "input", ({ value }) => this.#set({ alpha: Number(value) }, "alpha"));
    listen("remove-folds", "change", ({ checked }) =>
      this.#set({ folds: checked ? "remove" : "report" }),
    );
    listen("alpha-auto", "change", ({ checked }) =>
      this.#set({ alpha: checked ? null : alphaOf(state().document) }),
    );
    listen("outside", "change", ({ value }) =>
      this.#set({ outside: value === "colour" ? `${find("outside-colour").value}ff` : value }),
    );
    // The colour field has no alpha: keep the alpha of the current value.
    listen("outside-colour", "input", ({ value }) => {
      const before = outsideOf(state().document);
      this.#set(
        { outside: value + (typeof before === "string" ? before.slice(7) : "ff") },
        "outside",
      );
    });
    listen("filter", "change", ({ value }) =>
      this.#set({ filter: /** @type {Page.Filter} */ (value) }),
    );
    listen("canvas", "change", ({ value }) =>
      this.#set({ canvas: value === "box" ? this.#box() : value === "fit" ? "fit" : "same" }),
    );
    for (const name of BOX) listen(`canvas-${name}`, "change", () => this.#setBox());
    click("canvas-all", () => this.#set({ canvas: "fit" }));
    listen("compare-at", "input", ({ value }) =>
      store.do("show", { what: { compareAt: Number(value) } }),
    );
    this.#holds(find("before"));
  }

  /**
   * @param {Partial<Page.Document>} what
   * @param {string} [tag]
   */
  #set(what, tag = "") {
    this.actions.edit({ ...this.store.state.document, ...what }, { tag });
  }

  /** The shown canvas as a box. */
  #box() {
    const [x, y, width, height] = this.view.box;
    return { x, y, width, height };
  }

  #setBox() {
    const fields = BOX.map((name) => find(`canvas-${name}`));
    for (const field of fields) field.setAttribute("aria-invalid", String(!field.checkValidity()));
    if (!fields.every((field) => field.checkValidity())) return;
    const [x, y, width, height] = fields.map((field) => field.valueAsNumber);
    this.#set({ canvas: { x, y, width, height } });
  }

  /** @param {Page.Method} method */
  #setMethod(method) {
    this.#set({ method });
    if (takesPinsOnly({ method })) this.does.tool("point");
    if (takesLinesOnly({ method })) this.does.tool("line");
  }

  /**
   * Shows the original while the button is held by pointer or keyboard.
   * @param {HTMLElement} button
   */
  #holds(button) {
    /** @type {(on: boolean) => () => void} */
    const peek = (on) => () =>
      this.store.state.peek !== on && this.store.do("show", { what: { peek: on } });
    /** @type {(event: KeyboardEvent) => boolean} */
    const isPress = (event) => event.key === " " || event.key === "Enter";
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      peek(true)();
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"])
      button.addEventListener(end, peek(false));
    button.addEventListener(
      "keydown",
      (event) => isPress(event) && (event.preventDefault(), peek(true)()),
    );
    button.addEventListener("keyup", (event) => isPress(event) && peek(false)());
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** @param {Page.State} state */
  #draw(state) {
    const open = state.phase === "open";
    for (const node of findAll("[data-when=open]")) node.hidden = !open;
    find("drop").hidden = state.phase !== "empty";
    find("upload").hidden = state.phase !== "uploading";
    find("work").hidden = find("panel").hidden = !state.picture || state.phase === "empty";
    this.#drawUpload(state);
    this.#drawBend(state.document);
    this.#drawFit(state);
    this.#drawTools(state);
    this.#drawProblem(state.problem);
    text("title", state.picture ? `${state.picture.name}` : "");
    document.title = state.picture ? `${state.picture.name} – mlswarp` : "mlswarp";
    const { undo, redo } = steps(state);
    find("history").hidden = !open && !undo && !redo;
    find("undo").disabled = !undo && !state.draft.length;
    find("redo").disabled = !redo;
    find("waiting").hidden = !state.waiting;
    if (state.waiting) text("waiting-text", waitingWords(state.waiting));
    const none = !state.document.handles.length;
    find("handles-none").hidden = !none;
    for (const id of /** @type {const} */ ([
      "select-all",
      "put-back-all",
      "clear",
      "swap",
      "align",
    ]))
      find(id).disabled = none;
    find("align").value = alignOf(state.document);
    text("align-note", ALIGN[alignOf(state.document)]);
    this.#drawPicture();
  }

  /** @param {Page.State} state */
  #drawUpload({ phase, progress, uploadName }) {
    if (phase !== "uploading") return;
    find("upload-bar").value = progress;
    text(
      "upload-text",
      progress === 0
        ? `Opening ${uploadName}`
        : progress < 100
          ? `Uploading ${uploadName}: ${Math.round(progress)} %`
          : `Processing ${uploadName}`,
    );
  }

  /** @param {Page.State} state */
  #drawFit({ document, fit, fitShown }) {
    const why = noFitWords(document.handles.length, hasPinsOnly(document), LEAST_PINS);
    find("fit").disabled = why !== "";
    find("fit-arrows-label").hidden = !fit;
    find("fit-arrows").checked = fitShown;
    text("fit-note", fit?.words ?? why);
  }

  /** @param {Page.Document} document */
  #drawBend(document) {
    for (const [name, button] of this.#methods) {
      button.checked = name === document.method;
      button.disabled = !mayHave(document, name);
    }
    text("method-note", methodWords(document));
    this.#drawMetric(document);
    const isFocused = hasFocus(document);
    for (const id of /** @type {const} */ (["alpha", "alpha-auto"])) find(id).disabled = !isFocused;
    const pinsOnly = takesPinsOnly(document);
    for (const id of /** @type {const} */ (["tool-line", "tool-path"]))
      find(id).disabled = pinsOnly;
    // The border of a cut-out lies outside of what it shows.
    find("pin-border").disabled =
      pinsOnly || metricOf(document) === "geodesic" || (isOutlined(document) && this.#hasOutline);
    find("tool-point").disabled = takesLinesOnly(document);
    const alpha = alphaOf(document);
    find("alpha").value = String(alpha);
    find("alpha").setAttribute("aria-valuetext", `${alpha}. ${focusWords(alpha)}`);
    text("alpha-value", `${alpha}`);
    find("alpha-auto").checked = document.alpha === null;
    const automatic = alphaOf({ ...document, alpha: null });
    const focus = `${focusWords(alpha)}${alpha === automatic ? "" : ` Automatic would be ${automatic}.`}`;
    text(
      "alpha-note",
      isFocused
        ? focus
        : infoOf(document).mesh
          ? "This method has no focus: its mesh follows the outline."
          : "This method has no focus: each handle affects the whole picture.",
    );
    const select = find("grid-size");
    const tolerance = typeof document.grid === "object" ? document.grid.tolerance : 0;
    const value = tolerance ? JSON.stringify(document.grid) : String(document.grid);
    if (![...select.options].some((option) => option.value === value))
      select.add(new Option(tolerance ? `Within ${tolerance} px` : `${value} px`, value));
    select.value = value;
    select.disabled = infoOf(document).mesh;
    const outside = outsideOf(document);
    const kind = kindOfOutside(outside);
    this.#offerValue(typeof outside === "object" ? outside : null);
    find("outside").value = kind;
    find("outside-colour").hidden = kind !== "colour";
    if (kind === "colour") find("outside-colour").value = String(outside).slice(0, 7);
    text("outside-note", OUTSIDE[kind]);
    find("filter").value = filterOf(document);
    text("filter-note", FILTER[filterOf(document)]);
    this.#drawCanvas(document);
  }

  get #hasOutline() {
    const { document, picture } = this.store.state;
    return Boolean(picture?.isCutout) || regionOf(document).parts.length > 0;
  }

  /**
   * Where handles act: for pictures that have an outline, or a region.
   * @param {Page.Document} document
   */
  #drawMetric(document) {
    const metric = metricOf(document);
    const isInside = metric === "geodesic";
    find("metrics").hidden = find("metric-note").hidden = !this.#hasOutline && !isInside;
    for (const [name, button] of this.#metrics) {
      button.checked = name === metric;
      button.disabled = !hasFocus(document);
    }
    text("metric-note", metricWords(document));
    for (const id of /** @type {const} */ (["threshold-row", "threshold", "threshold-note"]))
      find(id).hidden = !isInside;
    const threshold = thresholdOf(document);
    find("threshold").value = String(threshold);
    text("threshold-value", `${Math.round(100 * threshold)} % opacity`);
  }

  /**
   * A value outside comes from a file of handles; the list has it as long as it is set.
   * @param {Page.OutsideValue | null} outside
   */
  #offerValue(outside) {
    const select = find("outside");
    const option = [...select.options].find(({ value }) => value === "value");
    if (!outside) option?.remove();
    else if (option) option.text = `Value ${outside.value}`;
    else select.add(new Option(`Value ${outside.value}`, "value"));
  }

  /** @param {Page.Document} document */
  #drawCanvas(document) {
    const canvas = canvasOf(document);
    const kind = typeof canvas === "object" ? "box" : canvas;
    find("canvas").value = kind;
    find("canvas-box").hidden = kind !== "box";
    if (typeof canvas === "object") {
      for (const name of BOX) {
        const field = find(`canvas-${name}`);
        // What is being typed stays until the canvas itself changes.
        if (field !== window.document.activeElement || canvas !== this.#canvas)
          field.value = String(canvas[name]);
      }
    }
    this.#canvas = canvas;
    const { size, mesh } = this.view;
    const cut =
      size && mesh && canvas !== "fit" && !regionOf(document).parts.length
        ? cutOff(mesh, boxOf(canvas, size, mesh))
        : null;
    const words = cut ? cutWords(cut) : "";
    text("canvas-note", words || CANVAS[kind]);
    find("canvas-all").hidden = !words;
  }

  /** @param {Page.State} state */
  #drawTools(state) {
    find(`tool-${state.tool}`).checked = true;
    press("mesh", state.meshShown);
    press("compare", state.compare);
    find("compare-bar").hidden = !state.compare;
    find("compare-at").value = String(state.compareAt);
    find("before").classList.toggle("held", state.peek);
    const {
      selection,
      draft,
      arm,
      document: { handles },
    } = state;
    const places = selection.length && this.#placesOf(state);
    find("selection").hidden = !selection.length || draft.length > 0 || state.compare;
    text(
      "selection-count",
      selection.length === 1 ? this.#nameOf(selection[0], handles) : `${selection.length} selected`,
    );
    press("move-to", arm === "move");
    press("select-more", state.more);
    const pin =
      selection.length === 1 &&
      !takesPinsOnly(state.document) &&
      canTwist(handles.find((h) => String(h.id) === selection[0]));
    for (const id of /** @type {const} */ (["rotate-left", "rotate-right"]))
      find(id).hidden = places < 2 && !pin;
    for (const id of /** @type {const} */ (["bring-front", "send-back"]))
      find(id).hidden = handles.length < 2;
    find("draft").hidden = !draft.length;
    find("draft-finish").disabled = draft.length < (state.tool === "lasso" ? 3 : 2);
    text("draft-text", `${toolName(state.tool)}: ${count(draft.length, "point")}`);
    this.#drawHint(state);
  }

  /**
   * @param {string} key
   * @param {Page.Handle[]} handles
   */
  #nameOf(key, handles) {
    const [id, vertex] = key.split(".");
    const index = handles.findIndex((h) => h.id === Number(id));
    return `${kindName(handles[index])} ${index + 1}${vertex === undefined ? "" : `.${Number(vertex) + 1}`}`;
  }

  /** @param {Page.State} state */
  #placesOf({ selection, document: { handles } }) {
    return selection.reduce(
      (n, key) =>
        n + (key.includes(".") ? 1 : (handles.find((h) => h.id === Number(key))?.p.length ?? 0)),
      0,
    );
  }

  /** @param {Page.State} state */
  #drawHint(state) {
    const which = hintFor(state);
    find("hint").hidden = !which;
    if (which)
      text("hint", HINTS[which][matchMedia("(pointer: coarse)").matches ? "touch" : "mouse"]);
  }

  /** @param {Page.Problem | null} problem */
  #drawProblem(problem) {
    find("problem").hidden = !problem;
    if (!problem) return;
    const { title, detail, advice } = problemWords(problem);
    text("problem-title", title);
    text("problem-detail", detail);
    text("problem-advice", advice);
    for (const [id, action] of /** @type {const} */ ([
      ["problem-action", this.does.mending(problem)],
      ["problem-other", this.does.alternative(problem)],
    ])) {
      find(id).hidden = !action;
      text(id, action ?? "");
    }
  }

  #drawZoom() {
    text("zoom-value", `${Math.round(100 * this.view.zoom * this.view.scale)} %`);
    const { beyond } = this.view;
    for (const side of SIDES) find(`pan-${side}`).hidden = !beyond[side];
  }

  /** Shows the figures of the last response. */
  #drawPicture() {
    const { shown, session } = this.sync;
    const edited = this.store.state.document;
    text("folds-note", foldWords(shown.folds));
    const isRemoved = edited.folds === "remove";
    find("remove-folds-label").hidden = !canUnfold(edited) || !(shown.folds || isRemoved);
    find("remove-folds").checked = isRemoved;
    find("folds").hidden = !shown.folds;
    text("folds", `${count(shown.folds, "cell")} ${shown.folds === 1 ? "folds" : "fold"}`);
    const grid = session?.grid;
    text(
      "grid-note",
      grid
        ? `${grid.columns} × ${grid.rows} vertices, ${Math.round(grid.cell[0] * 10) / 10} px apart.`
        : "",
    );
    const [, , width, height] = this.view.size ? this.view.box : [0, 0, 0, 0];
    const rows = timingRows(shown, this.view.size && [width, height]);
    text("status", this.store.state.phase === "open" ? statusWords(shown) : "");
    // Not during a drag: it is read aloud.
    if (this.sync.condition === "ready") this.#drawCanvas(this.store.state.document);
    const key = rows.join();
    if (key === this.#timing) return;
    this.#timing = key;
    find("timing").replaceChildren(
      ...rows.flatMap(([id, name, value]) => {
        const [term, words] = [document.createElement("dt"), document.createElement("dd")];
        Object.assign(words, { id: `timing-${id}`, textContent: value });
        term.textContent = name;
        return [term, words];
      }),
    );
    this.#drawBar(shown.report?.timing ?? {});
  }

  /** @param {Record<string, number>} timing */
  #drawBar(timing) {
    const stages = Object.keys(STAGES).filter((name) => timing[name] > 0);
    const bar = find("timing-bar");
    bar.replaceChildren(
      ...stages.map((name) => {
        const part = document.createElement("span");
        part.className = name;
        part.style.flexGrow = String(1000 * timing[name]);
        return part;
      }),
    );
  }
}

/**
 * The warnings about the shown picture, under it.
 * @type {(shown: Page.Shown) => string}
 */
const statusWords = ({ warnings }) =>
  warnings
    .map((w) => WARNINGS[w])
    .filter(Boolean)
    .join(" ");

/**
 * The hint for the current state: a key of HINTS, or null.
 * @param {Page.State} state
 * @returns {keyof typeof HINTS | null}
 */
function hintFor({
  phase,
  document,
  tool,
  arm,
  draft,
  compare,
  problem,
  selection,
  past,
  before,
  playing,
}) {
  if (phase !== "open" || draft.length || compare || problem || playing !== null) return null;
  const { handles } = document;
  if (arm) return "move";
  if (isRegionTool(tool)) return regionOf(document).parts.length ? null : tool;
  if (tool !== "point") return selection.length ? null : tool;
  if (!handles.length) return "first";
  if (handles.length === 1 && handles[0].p.length === 1 && !before) return "one";
  return past.length || selection.length ? null : "sample";
}

/** @type {(n: number) => string} */
const ms = (n) => `${n < 10 ? n.toFixed(2) : n.toFixed(1)} ms`;

/**
 * @param {Page.Shown} shown
 * @param {Page.Size | null} size
 * @returns {[id: string, name: string, value: string][]}
 */
function timingRows({ report, residual, rate }, size) {
  if (!report) return [];
  /** @type {[id: string, name: string, value: string][]} */
  const rows = Object.entries(STAGES)
    .filter(([name]) => report.timing[name] !== undefined)
    .map(([name, words]) => [name, words, ms(report.timing[name])]);
  if (report.trip !== undefined) rows.push(["trip", "Round trip", ms(report.trip)]);
  rows.push(["size", "Size", `${size ? `${size[0]} × ${size[1]}, ` : ""}${bytes(report.size)}`]);
  if (residual !== null) rows.push(["residual", "Residual", `${residual.toFixed(2)} px`]);
  if (rate) rows.push(["rate", "While dragging", `${Math.round(rate)} frames/s`]);
  return rows;
}
