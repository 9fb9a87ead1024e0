// The handles as SVG over the picture: one focusable element per point; for a line, one for the
// whole and one per vertex. Positions are in picture px, the drawing in CSS px of the stage, so
// that dots have the same size at every zoom. A canvas shows those that are not selected
// (marks.js).

import { inStage, known } from "./dom.js";
import { circleOf, kindName, kindOf, posedPlaces, takesPinsOnly } from "./edits.js";
import { FEW_SELECTED, LEAST_WAY, Marks, PLATE, STALK } from "./marks.js";
import { isRegionTool } from "./region.js";
import { withRoom } from "./numbers.js";
import { canTwist } from "./twist.js";
import { marked, places as placesWords, residualWords } from "./words.js";

const SPACE = "http://www.w3.org/2000/svg";
/**
 * Hit radius of a vertex or a line, CSS px: 24 px across for a mouse, 44 px for touch.
 * @type {Record<Page.PointerKind, number>}
 */
export const REACH = { mouse: 12, pen: 14, touch: 22 };
/** Distance of the selection ring from the vertices, CSS px. */
const RING_OFF = 26;
/** Radius of the ring of a pin, CSS px. */
const PIN_RING = { mouse: 30, touch: 40 };
const isCoarse = () => matchMedia("(pointer: coarse)").matches;

/**
 * @template {keyof SVGElementTagNameMap} Name
 * @param {Name} name
 * @param {Attributes} [attributes]
 * @param {...Node} children
 */
function element(name, attributes = {}, ...children) {
  const made = document.createElementNS(SPACE, name);
  set(made, attributes);
  made.append(...children);
  return made;
}

/**
 * Sets changed attributes; null removes one.
 * @param {Element} node
 * @param {Attributes} attributes
 */
function set(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null) node.removeAttribute(name);
    else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, String(value));
  }
}

/** @type {(places: Page.Place[]) => string} */
const list = (places) => places.map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ");
/** @type {(place: Page.Place) => string} */
const at = ([x, y]) => `translate(${x.toFixed(2)} ${y.toFixed(2)})`;

/**
 * The path of an arrow by (dx, dy) that ends at the rim of a dot; empty if it is shorter than that.
 * @param {Page.Place} place
 * @param {Page.Place} way
 */
function arrowTo([x, y], [dx, dy]) {
  const [length, rim, head] = [Math.hypot(dx, dy), 9.5, 6];
  if (length < rim + 2) return "";
  const [ux, uy] = [dx / length, dy / length];
  const [tx, ty] = [x - rim * ux, y - rim * uy];
  /** @type {(side: number) => string} */
  const wing = (side) =>
    `${(tx - head * ux + side * head * 0.7 * uy).toFixed(2)} ${(ty - head * uy - side * head * 0.7 * ux).toFixed(2)}`;
  const tip = `L${tx.toFixed(2)} ${ty.toFixed(2)}`;
  return `M${(x - dx).toFixed(2)} ${(y - dy).toFixed(2)}${tip}M${wing(1)}${tip}L${wing(-1)}`;
}

/** @type {(handle: Page.Handle, vertex: number | null) => string} */
export const keyOf = (handle, vertex) =>
  vertex === null || handle.p.length === 1 ? String(handle.id) : `${handle.id}.${vertex}`;

/** @typedef {Record<string, string | number | boolean | null>} Attributes */

/**
 * What draws a handle: the whole, and a node for each vertex of a line; `look` tells whether it
 * must be drawn again.
 *
 * @typedef {{
 *   handle: Page.Handle | null,
 *   look: string,
 *   count: number,
 *   whole: SVGGElement,
 *   places: SVGGElement[],
 *   ghosts: SVGGElement[],
 *   onCanvas: boolean,
 *   mark: Page.Mark,
 * }} Nodes
 */

/**
 * What the looks of a handle depend on, besides the handle; `inSvg`: the SVG draws what is
 * selected.
 *
 * @typedef {{
 *   place: string,
 *   selected: Set<string>,
 *   inSvg: boolean,
 *   moving: boolean,
 *   faults: Set<number>,
 *   warnings: Set<number>,
 *   residual: (index: number) => string,
 * }} Looks
 */

export class Handles {
  /**
   * The selection rectangle in stage px: [[x, y], [x, y]] or null; and the pointer position while a
   * line is drawn.
   * @type {[Page.Place, Page.Place] | null}
   */
  marquee = null;
  /**
   * The circle of a selection that is being turned, and the angle of its knob.
   *
   * @type {Page.Circle & { angle: number } | null}
   */
  turning = null;
  /** @type {Page.Place | null} */
  pointer = null;

  /**
   * The nodes of a handle, by its id.
   *
   * @type {Map<number, Nodes>}
   */
  #drawn = new Map();
  #thinned = "";
  /** @type {Page.Document | null} */
  #thinnedFor = null;

  /**
   * @param {SVGSVGElement} svg
   * @param {Page.Store} store
   * @param {Page.View} view
   */
  constructor(svg, store, view) {
    this.svg = svg;
    this.store = store;
    this.view = view;
    this.marks = new Marks(inStage(view.stage, "marks"), inStage(view.stage, "moving"), view);
    this.ghosts = element("g", { class: "ghosts", "aria-hidden": true });
    this.fit = element("g", { id: "residuals", "aria-hidden": true });
    this.ring = element("circle", { id: "ring", class: "ring", part: "ring", "aria-hidden": true });
    this.ringShade = element("circle", { class: "ring shade", "aria-hidden": true });
    // A round arrow on a stalk, so that it does not look like a handle.
    this.knob = element("g", {
      id: "ring-knob",
      class: "knob",
      tabindex: 0,
      role: "button",
      "aria-label": "Rotate the selection",
    });
    const turn = ["shade", "glyph"].map((name) =>
      element("path", { class: name, d: "M4.6-5.2A7 7 0 1 0 7 0M7.4-8.6 5-5 1-6" }),
    );
    this.stalk = element("line", { class: "stalk" });
    this.degrees = element("text", {
      class: "degrees",
      y: -16,
      "text-anchor": "middle",
      "aria-hidden": true,
    });
    this.knob.append(
      element("circle", { class: "hit", r: isCoarse() ? 22 : 14 }),
      element("circle", { class: "halo", r: 12 }),
      this.stalk,
      element("circle", { class: "plate", r: PLATE }),
      ...turn,
      this.degrees,
    );
    this.draft = element(
      "g",
      { class: "draft", "aria-hidden": true },
      element("polyline", { class: "under" }),
      element("polyline", { class: "over" }),
    );
    this.frame = element("rect", {
      id: "marquee",
      class: "marquee",
      part: "selection",
      "aria-hidden": true,
    });
    this.cross = element("path", {
      id: "cross",
      class: "cross",
      d: "M-14 0H-4M4 0H14M0-14V-4M0 4V14",
      "aria-hidden": true,
    });
    this.body = element("g");
    svg.replaceChildren(
      this.ghosts,
      this.fit,
      this.body,
      this.ringShade,
      this.ring,
      this.knob,
      this.draft,
      this.frame,
      this.cross,
    );
    store.subscribe(() => this.draw());
    view.subscribe(() => this.draw());
  }

  draw() {
    const { state } = this.store;
    const { handles } = state.document;
    const isAway = state.compare || state.peek || state.playing !== null;
    set(this.svg, {
      class: isAway ? "away" : isRegionTool(state.tool) ? "aside" : state.before ? "moving" : "",
    });
    const counts = new Map(handles.map(({ id, p }) => [id, p.length]));
    for (const [id, nodes] of this.#drawn) {
      if (counts.get(id) === nodes.count) continue;
      for (const node of [nodes.whole, ...nodes.places, ...nodes.ghosts]) node.remove();
      this.#drawn.delete(id);
    }
    const { fit, fitShown } = state;
    /** @type {Looks} */
    const looks = {
      place: `${this.view.zoom} ${this.view.toStage([0, 0])}`,
      selected: new Set(state.selection),
      inSvg: state.selection.length <= FEW_SELECTED,
      moving: state.before !== null,
      faults: new Set(marked(state.problem)),
      warnings: new Set([...state.apart, ...(fit && fitShown ? fit.outliers : [])]),
      residual: fit
        ? (index) => residualWords(fit.residuals[index], fit.outliers.includes(index))
        : () => "",
    };
    /** @type {Element | null} */
    let last = null;
    /** @type {import("./marks.js").MarkedHandle[]} */
    const plain = [];
    /** @type {import("./marks.js").MarkedHandle[]} */
    const drawnHere = [];
    for (const [index, handle] of handles.entries()) {
      const nodes = this.#drawn.get(handle.id) ?? this.#make(handle);
      this.#update(nodes, handle, index, looks);
      (nodes.onCanvas ? plain : drawnHere).push({ handle, ...nodes.mark });
      // A handle restored by undo returns to its old position in the order.
      if (nodes.whole.parentNode !== this.body || nodes.whole.previousElementSibling !== last)
        (last ? last.after.bind(last) : this.body.prepend.bind(this.body))(
          nodes.whole,
          ...nodes.places,
        );
      last = nodes.places.at(-1) ?? nodes.whole;
    }
    this.#drawFit(state);
    this.#thinOut(state);
    const ring = this.#drawRing(state);
    this.marks.draw(
      plain,
      state.before ? drawnHere : null,
      ring,
      isAway || isRegionTool(state.tool),
    );
    this.#drawDraft(state);
    this.#drawMarks(state);
  }

  /** @param {Page.Handle} handle */
  #make(handle) {
    /** @type {(...parts: Node[]) => SVGGElement} */
    const focusable = (...parts) => element("g", { role: "button", tabindex: 0 }, ...parts);
    /** @type {(small: boolean) => SVGGElement} */
    const place = (small) => {
      const label = element("text", { class: "number", y: -15, "text-anchor": "middle" });
      const rim = small
        ? element("rect", { class: "rim", x: -7.5, y: -7.5, width: 15, height: 15, rx: 5 })
        : element("circle", { class: "rim", r: 9.5 });
      const shape = small
        ? element("rect", {
            class: "dot",
            part: "handle",
            x: -5,
            y: -5,
            width: 10,
            height: 10,
            rx: 3,
          })
        : element("circle", { class: "dot", part: "handle", r: 7 });
      return focusable(
        element("circle", { class: "hit", r: 12 }),
        element("circle", { class: "halo", r: 12 }),
        rim,
        shape,
        label,
      );
    };
    const line = () =>
      focusable(
        ...["hit", "halo", "rim", "under", "over"].map((name) =>
          element("polyline", { class: name, part: name === "over" ? "line" : null }),
        ),
      );
    const single = handle.p.length === 1;
    const ghosts = handle.p.map(() =>
      element(
        "g",
        {},
        element("line", { class: "rim" }),
        element("line"),
        element("circle", { r: 3.2 }),
      ),
    );
    /** @type {Nodes} */
    const nodes = {
      handle: null,
      look: "",
      count: handle.p.length,
      whole: single ? place(false) : line(),
      places: single ? [] : handle.p.map(() => place(true)),
      ghosts,
      onCanvas: false,
      mark: { pressed: [], fault: null, labels: [] },
    };
    this.ghosts.append(...ghosts);
    this.#drawn.set(handle.id, nodes);
    return nodes;
  }

  /**
   * Draws a handle, unless it looks as before: most do in a frame of a drag.
   * @param {Nodes} nodes
   * @param {Page.Handle} handle
   * @param {number} index
   * @param {Looks} looks
   */
  #update(
    nodes,
    handle,
    index,
    { place: frame, selected, inSvg, moving, faults, warnings, residual },
  ) {
    const fault = faults.has(index) ? "" : warnings.has(index) ? "warning" : null;
    const whole = selected.has(String(handle.id));
    const pressedAt = handle.q.map((_, k) => whole || selected.has(`${handle.id}.${k}`));
    const words = residual(index);
    const look = `${index} ${fault} ${pressedAt} ${inSvg} ${moving} ${frame} ${words}`;
    if (nodes.handle === handle && nodes.look === look) return;
    const onCanvas = fault === null && !(inSvg && pressedAt.includes(true));
    const labels = handle.q.map((_, k) =>
      this.#labelOf(nodes, k, pressedAt[k] || fault !== null, index),
    );
    Object.assign(nodes, { handle, look, onCanvas, mark: { pressed: pressedAt, fault, labels } });
    // In a drag the SVG is not seen: what is drawn stays as it is, and only what is told follows.
    const posed = moving ? null : handle.q.map((place) => this.view.toStage(place));
    const name = `${kindName(handle)} ${index + 1}`;
    const common = {
      "data-handle": index,
      "data-kind": kindOf(handle),
      "data-fault": fault,
      "data-canvas": onCanvas ? "" : null,
    };
    const single = handle.p.length === 1;
    set(nodes.whole, {
      ...common,
      id: `handle-${index}`,
      "aria-pressed": whole,
      "aria-label": single ? `${name} at ${placesWords(handle.q)}${words}` : name,
    });
    if (single) this.#updatePlace(nodes.whole, posed?.[0], handle.q[0], index + 1);
    else if (posed) for (const part of nodes.whole.children) set(part, { points: list(posed) });
    nodes.places.forEach((node, k) => {
      set(node, {
        ...common,
        id: `handle-${index}-${k}`,
        "data-vertex": k,
        "aria-pressed": pressedAt[k],
        "aria-label": `${name}.${k + 1} at ${placesWords([handle.q[k]])}`,
      });
      this.#updatePlace(node, posed?.[k], handle.q[k], `${index + 1}.${k + 1}`);
    });
    if (!posed) return;
    nodes.ghosts.forEach((ghost, k) => {
      const [x, y] = this.view.toStage(handle.p[k]);
      const away = Math.hypot(posed[k][0] - x, posed[k][1] - y) > LEAST_WAY;
      set(ghost, { display: away && !onCanvas ? null : "none" });
      if (onCanvas) return;
      for (const line of ghost.querySelectorAll("line"))
        set(line, { x1: x, y1: y, x2: posed[k][0], y2: posed[k][1] });
      set(known(ghost.lastElementChild), { cx: x, cy: y });
    });
  }

  /**
   * The number that a vertex shows on the canvas, if it has room.
   * @param {Nodes} nodes
   * @param {number} k
   * @param {boolean} isShown
   * @param {number} index
   */
  #labelOf(nodes, k, isShown, index) {
    const node = nodes.places[k] ?? nodes.whole;
    return isShown && node.getAttribute("class") !== "crowded"
      ? `${index + 1}${nodes.places.length ? `.${k + 1}` : ""}`
      : "";
  }

  /**
   * @param {Element} node
   * @param {Page.Place | undefined} stage
   * @param {Page.Place} place
   * @param {string | number} label
   */
  #updatePlace(node, stage, place, label) {
    set(node, { ...(stage && { transform: at(stage) }), "data-x": place[0], "data-y": place[1] });
    const shown = known(node.lastChild);
    if (shown.textContent !== String(label)) shown.textContent = String(label);
  }

  /**
   * An arrow from the prediction of each pin to the pin, as long as the residual times the scale.
   * @param {Page.State} state
   */
  #drawFit({ fit, fitShown, document: { handles } }) {
    const shown = fit && fitShown ? handles : [];
    while (this.fit.children.length > shown.length) this.fit.lastChild?.remove();
    shown.forEach(({ q: [place] }, index) => {
      const arrow =
        this.fit.children[index] ??
        this.fit.appendChild(
          element("g", {}, ...["rim", "over"].map((name) => element("path", { class: name }))),
        );
      if (!fit) return;
      const outlier = fit.outliers.includes(index);
      set(arrow, { class: outlier ? "outlier" : null, "data-residual": index });
      const d = arrowTo(
        this.view.toStage(place),
        fit.residuals[index].map((c) => c * fit.scale * this.view.zoom),
      );
      for (const part of arrow.children) set(part, { d });
    });
  }

  /**
   * Circle around a selected pin, or around a selection with two or more vertices, stage px;
   * otherwise null.
   * @returns {Page.Ring | null}
   */
  ringAt() {
    const { document, selection, draft, arm } = this.store.state;
    if (draft.length || arm) return null;
    const pin = this.#pin(this.store.state);
    const places = pin ? pin.q : posedPlaces(document, selection);
    if (!places.length || (places.length < 2 && !pin)) return null;
    const { centre, radius } = this.turning ?? circleOf(places);
    const middle = this.view.toStage(centre);
    const angle =
      -Math.PI / 4 +
      (pin
        ? (((pin.twist?.angle ?? 0) - (pin.twist?.free ?? 0)) * Math.PI) / 180
        : (this.turning?.angle ?? 0));
    /** @type {(r: number) => Page.Place} */
    const knobAt = (r) => [
      middle[0] + (r + STALK) * Math.cos(angle),
      middle[1] + (r + STALK) * Math.sin(angle),
    ];
    if (pin) {
      const r = isCoarse() ? PIN_RING.touch : PIN_RING.mouse;
      return { pin, centre, middle, r, knob: knobAt(r) };
    }
    // Keep the knob inside the stage for large selections.
    const room = [Math.cos(angle), Math.sin(angle)].map(
      (way, axis) =>
        ((way > 0 ? this.view.stageSize[axis] - RING_OFF - STALK : RING_OFF + STALK) -
          middle[axis]) /
        way,
    );
    const r = Math.max(RING_OFF, Math.min(radius * this.view.zoom + RING_OFF, ...room));
    return { pin: null, centre, middle, r, knob: knobAt(r) };
  }

  /**
   * @param {Page.State} state
   * @returns {Page.Ring & { degrees: string } | null}
   */
  #drawRing({ before }) {
    const ring = this.ringAt();
    const degrees = ring?.pin?.twist?.angle;
    const words =
      degrees !== undefined && (before || degrees !== 0) ? `${Math.round(degrees)}°` : "";
    if (before) return ring && { ...ring, degrees: words };
    const visibility = ring ? "visible" : "hidden";
    for (const circle of [this.ringShade, this.ring])
      set(circle, {
        visibility,
        ...(ring && { cx: ring.middle[0], cy: ring.middle[1], r: ring.r }),
      });
    set(this.knob, {
      visibility,
      tabindex: ring ? 0 : -1,
      ...(ring && { transform: at(ring.knob) }),
    });
    if (!ring) return null;
    const [x, y] = [0, 1].map((axis) => (ring.middle[axis] - ring.knob[axis]) / (ring.r + STALK));
    set(this.stalk, { x1: x * STALK, y1: y * STALK, x2: x * PLATE, y2: y * PLATE });
    set(this.knob, {
      "aria-label": ring.pin
        ? `Twist the pin${degrees === undefined ? "" : `, now ${degrees} degrees`}: arrow keys turn it by 1 degree`
        : "Rotate the selection: arrow keys rotate by 1 degree",
    });
    if (this.degrees.textContent !== words) this.degrees.textContent = words;
    return null;
  }

  /**
   * Hides numbers without room. Not during a drag, so that they do not flicker.
   * @param {Page.State} state
   */
  #thinOut({ selection, document, before, compare, peek }) {
    if (before || compare || peek) return;
    const key = `${this.view.zoom} ${selection} ${document.handles.length}`;
    if (key === this.#thinned && (document === this.#thinnedFor || selection.length < 2)) return;
    this.#thinned = key;
    this.#thinnedFor = document;
    const chosen = new Set(selection);
    /** @type {[x: number, y: number, text: string, wanted: boolean][]} */
    const marks = [];
    /** @type {Element[]} */
    const nodes = [];
    for (const handle of document.handles) {
      const drawn = known(this.#drawn.get(handle.id));
      handle.q.forEach((place, k) => {
        const node = drawn.places[k] ?? drawn.whole;
        nodes.push(node);
        marks.push([
          ...this.view.toStage(place),
          known(known(node.lastChild).textContent),
          chosen.has(String(handle.id)) || chosen.has(`${handle.id}.${k}`),
        ]);
      });
    }
    const room = withRoom(marks);
    nodes.forEach((node, k) =>
      set(node, { class: marks[k][3] && !room.has(k) ? "crowded" : null }),
    );
  }

  /**
   * The pin of a selection that is a single point and may be twisted, or null.
   * @param {Page.State} state
   * @returns {Page.Handle | null}
   */
  #pin({ document, selection }) {
    const handle =
      selection.length === 1
        ? document.handles.find((h) => String(h.id) === selection[0])
        : undefined;
    return handle && canTwist(handle) && !takesPinsOnly(document) ? handle : null;
  }

  /** @param {Page.State} state */
  #drawDraft({ draft, cross }) {
    const posed = draft.map((place) => this.view.toStage(place));
    const next = this.pointer ?? (cross ? this.view.toStage(cross) : null);
    const line = list(posed.length && next ? [...posed, next] : posed);
    for (const part of this.draft.querySelectorAll("polyline")) set(part, { points: line });
    const dots = this.draft.querySelectorAll("rect");
    for (let k = posed.length; k < dots.length; k++) dots[k].remove();
    posed.forEach((place, k) => {
      const dot =
        dots[k] ??
        this.draft.appendChild(
          element("rect", { class: "dot", x: -5, y: -5, width: 10, height: 10, rx: 3 }),
        );
      set(dot, { transform: at(place) });
    });
  }

  /** @param {Page.State} state */
  #drawMarks({ cross }) {
    const box = this.marquee;
    set(this.frame, { visibility: box ? "visible" : "hidden" });
    if (box) {
      const [[ax, ay], [bx, by]] = box;
      set(this.frame, {
        x: Math.min(ax, bx),
        y: Math.min(ay, by),
        width: Math.abs(ax - bx),
        height: Math.abs(ay - by),
      });
    }
    set(this.cross, {
      visibility: cross ? "visible" : "hidden",
      ...(cross && { transform: at(this.view.toStage(cross)) }),
    });
  }

  /**
   * Hit test at a stage position: { knob: true }, { handle, index, vertex } (vertex null: the whole
   * handle), or null.
   * @param {Page.Place} place
   * @param {string} kind
   * @returns {Page.Named | { knob: true, pin: Page.Handle | null } | null}
   */
  hit([x, y], kind) {
    const ring = this.ringAt();
    const reach = REACH[/** @type {Page.PointerKind} */ (kind)] ?? REACH.mouse;
    const fromKnob = ring ? Math.hypot(ring.knob[0] - x, ring.knob[1] - y) : Infinity;
    const { handles } = this.store.state.document;
    let best = /** @type {Page.Named | null} */ (null);
    let least = Infinity;
    handles.forEach((handle, index) => {
      handle.q.forEach((place, vertex) => {
        const [px, py] = this.view.toStage(place);
        const away = Math.hypot(px - x, py - y);
        if (away <= reach && away <= least)
          [best, least] = [{ handle, index, vertex: handle.p.length === 1 ? null : vertex }, away];
      });
    });
    // Between a pin's knob and another handle, the nearer one.
    if (ring && fromKnob <= Math.max(14, reach) && (fromKnob <= least || !ring.pin))
      return { knob: true, pin: ring.pin };
    if (best) return best;
    least = reach;
    handles.forEach((handle, index) => {
      const posed = handle.q.map((place) => this.view.toStage(place));
      for (let k = 1; k < posed.length; k++) {
        const away = distanceToSegment([x, y], posed[k - 1], posed[k]);
        if (away <= least) [best, least] = [{ handle, index, vertex: null }, away];
      }
    });
    return best;
  }

  /**
   * Selection keys inside a stage rectangle: the whole handle if all vertices are inside, otherwise
   * the vertices.
   * @param {[Page.Place, Page.Place]} corners
   */
  inside([[ax, ay], [bx, by]]) {
    /** @type {(place: Page.Place) => boolean} */
    const within = (place) => {
      const [x, y] = this.view.toStage(place);
      return (
        x >= Math.min(ax, bx) &&
        x <= Math.max(ax, bx) &&
        y >= Math.min(ay, by) &&
        y <= Math.max(ay, by)
      );
    };
    return this.store.state.document.handles.flatMap((handle) => {
      const kept = handle.q.map((place, k) => (within(place) ? k : -1)).filter((k) => k >= 0);
      return kept.length === handle.q.length
        ? [String(handle.id)]
        : kept.map((k) => keyOf(handle, k));
    });
  }

  /**
   * The handle or vertex of an SVG element.
   * @param {EventTarget | null} target
   * @returns {Page.Named | null}
   */
  named(target) {
    /** @type {SVGElement | null} */
    const node = target instanceof Element ? target.closest("[data-handle]") : null;
    if (!node) return null;
    const index = Number(node.dataset.handle);
    const handle = this.store.state.document.handles[index];
    return handle
      ? {
          handle,
          index,
          vertex: node.dataset.vertex === undefined ? null : Number(node.dataset.vertex),
        }
      : null;
  }

  /**
   * Focuses the element of a handle without scrolling.
   * @param {number} index
   * @param {number | null} [vertex]
   */
  focus(index, vertex = null) {
    const id = vertex === null ? `#handle-${index}` : `#handle-${index}-${vertex}`;
    /** @type {SVGElement | null} */
    const node = this.svg.querySelector(id);
    node?.focus({ preventScroll: true });
  }
}

/**
 * @param {Page.Place} place
 * @param {Page.Place} from
 * @param {Page.Place} to
 */
function distanceToSegment([x, y], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const length = dx * dx + dy * dy;
  const t = length ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}
