// The user actions on handles, shared by pointer, keyboard and buttons.

import { known } from "./dom.js";
import * as edits from "./edits.js";
import { keyOf } from "./handles.js";
import { insideOf } from "./outline.js";
import { brushSizeOf, isRegionTool, partOf, regionOf, withPart, withoutRegion } from "./region.js";
import { angleOf, canTwist, freeTurn, longest } from "./twist.js";
import { LINES_ONLY, OUTLINE, PINS_ONLY, count, places } from "./words.js";

/** Places that are this near to the outline, CSS px, mean what is inside. */
const SNAP = 24;

export class Actions {
  /**
   * `step`: undo (true) or redo of what is more than an edit: opening or closing a picture. `tell`
   * shows words too, where `say` only has them read aloud.
   * @param {Page.Store} store
   * @param {Pick<Page.Sync, "mesh" | "aligned">} sync
   * @param {Page.View} view
   * @param {Page.Handles} handles
   * @param {(words: string) => void} say
   * @param {(back: boolean) => void} step
   * @param {(words: string) => void} [tell]
   */
  constructor(store, sync, view, handles, say, step, tell = say) {
    this.store = store;
    this.sync = sync;
    this.view = view;
    this.handles = handles;
    this.say = say;
    this.step = step;
    this.tell = tell;
  }

  get state() {
    return this.store.state;
  }

  /**
   * @param {Page.Document} document
   * @param {{ tag?: string, select?: string[] }} [more]
   */
  edit(document, more = {}) {
    this.store.do("edit", { document, now: performance.now(), ...more });
  }

  /**
   * The rest position of a posed position, by the inverse of the shown grid.
   * @param {Page.Place} place
   */
  restOf(place) {
    return this.sync.mesh ? this.sync.mesh.inverse(...place) : place;
  }

  /** @param {Page.Place} place */
  inPicture([x, y]) {
    const [width, height] = this.view.size ?? [0, 0];
    return x >= 0 && y >= 0 && x <= width && y <= height;
  }

  /**
   * Adds a handle at these posed positions, selects it and focuses it. What lies beside an outline
   * is moved to the nearest place inside, if that is within `reach` px. A draft stays if it is
   * refused: it may be many taps.
   * @param {Page.Place[]} posed
   * @param {number} [reach]
   */
  add(posed, reach = SNAP / this.view.zoom) {
    if (posed.length > 1 && edits.takesPinsOnly(this.state.document)) return this.say(PINS_ONLY);
    if (posed.length < 2 && edits.takesLinesOnly(this.state.document)) return this.say(LINES_ONLY);
    const rest = posed.map((place) => this.restOf(place));
    const { inside } = this;
    const p = rest.map((place) => (inside ? inside.placeFor(place, reach) : place));
    if (!p.every((place) => place !== null)) return this.tell(OUTLINE.beside);
    if (inside && !inside.sees(p)) return this.tell(OUTLINE.leaves);
    const isMoved = p.some((place, k) => place !== rest[k]);
    const q = p.map((place, k) =>
      place === rest[k] ? posed[k] : (this.sync.mesh?.forward(...place) ?? place),
    );
    const made = edits.added(this.state.document, p, q);
    if (!made) return this.tell(isMoved ? OUTLINE.beside : "A line needs two different points");
    const document = this.#keepFocus(made.document);
    this.store.do("draft", { places: [] });
    this.edit(document, { select: [made.key] });
    const index = this.state.document.handles.length - 1;
    const handle = this.state.document.handles[index];
    this.handles.focus(index);
    this.say(
      `${edits.kindName(handle)} ${index + 1} added at ${places(handle.q)}${this.#focusKept(document === made.document)}`,
    );
    if (isMoved) this.tell(OUTLINE.moved(1));
  }

  /** What is inside of the outline that handles act in; null without one. */
  get inside() {
    const { document, picture } = this.state;
    const has = picture?.isCutout || regionOf(document).parts.length > 0;
    return has ? insideOf(this.view, document) : null;
  }

  /** Moves what lies beside the outline to the nearest places inside. */
  moveInside() {
    const { document } = this.state;
    const handles = insideOf(this.view, document)?.moved(document.handles) ?? document.handles;
    this.edit({ ...document, handles });
    this.tell(OUTLINE.moved(handles.filter((h, k) => h !== document.handles[k]).length));
  }

  /**
   * Deletes handles by their indices.
   * @param {number[]} indices
   */
  removeThose(indices) {
    this.remove(indices.map((index) => String(this.state.document.handles[index].id)));
  }

  /** Lets handles act in the plane, wherever they are. */
  actAcross() {
    const { document } = this.state;
    const method = edits.infoOf(document).mesh ? "rigid" : document.method;
    this.edit({ ...document, method, metric: "euclidean" });
  }

  /**
   * A click on the picture that hits no handle.
   * @param {Page.Place} place
   */
  place(place) {
    const { tool, draft, arm } = this.state;
    if (arm === "move") return this.moveTo(place);
    if (tool === "point") return this.add([place]);
    if (tool === "brush") return this.outline([place]);
    const places = [...draft, place];
    if (tool === "line" && places.length === 2) {
      this.store.do("draft", { places: [] });
      return this.add(places);
    }
    this.store.do("draft", { places });
    this.say(`${edits.toolName(tool)}: ${count(places.length, "point")}`);
  }

  /**
   * Adds what lasso or brush have drawn along these places to the region, or takes it away.
   * @param {Page.Place[]} places
   */
  outline(places) {
    const { state } = this;
    const part = partOf(state, places, Math.min(1, 0.5 / this.view.zoom));
    this.store.do("draft", { places: [] });
    if (!part) return this.say("The lasso encloses nothing");
    this.edit(this.#withPart(part));
    this.say(part.removes ? "Removed from the region" : "Added to the region");
  }

  /**
   * With the first part of a region: a cut-out leaves nothing where it was, unless the user has
   * chosen otherwise.
   * @param {Page.RegionPart} part
   * @returns {Page.Document}
   */
  #withPart(part) {
    const { document, picture } = this.state;
    const next = withPart(document, part);
    const isFirst = !regionOf(document).parts.length && (document.holes ?? null) === null;
    return isFirst && picture?.isCutout ? { ...next, holes: "transparent" } : next;
  }

  invertRegion() {
    this.edit(this.#withPart({ kind: "invert" }));
    this.say("Region inverted");
  }

  clearRegion() {
    if (!regionOf(this.state.document).parts.length) return;
    this.edit(withoutRegion(this.state.document));
    this.say("The whole picture moves");
  }

  /**
   * Makes the brush larger (1) or smaller (-1) by a fifth.
   * @param {number} way
   */
  resizeBrush(way) {
    const size = brushSizeOf(this.state);
    const next = way > 0 ? Math.ceil(1.2 * size) : Math.floor(size / 1.2);
    const brush = Math.min(Math.max(...known(this.view.size)), Math.max(1, next));
    this.store.do("show", { what: { brush } });
    this.say(`Brush ${brush} px`);
  }

  finish() {
    const { draft, tool } = this.state;
    if (tool === "lasso") this.outline(draft);
    else if (draft.length > 1) this.add(draft);
    else this.store.do("draft", { places: [] });
  }

  /**
   * Moves the centre of the selection to a position.
   * @param {Page.Place} place
   */
  moveTo(place) {
    const { document, selection } = this.state;
    const { centre } = edits.circleOf(edits.posedPlaces(document, selection));
    this.store.do("arm", { arm: "" });
    this.edit(edits.translated(document, selection, place[0] - centre[0], place[1] - centre[1]));
    this.sayWhere();
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  nudge(dx, dy) {
    const { document, selection } = this.state;
    this.edit(edits.translated(document, selection, dx, dy), { tag: `nudge ${selection}` });
    this.sayWhere();
  }

  /**
   * Says what `#keepFocus` has done.
   * @param {boolean} unchanged
   */
  #focusKept(unchanged) {
    return unchanged
      ? ""
      : `. Focus stays at ${edits.alphaOf(this.state.document)}, so that the other handles keep their effect`;
  }

  /** @param {Page.Document} next */
  #keepFocus(next) {
    return edits.keepingFocus(this.state.document, next);
  }

  /**
   * How a pin is turned and scaled by the other handles alone, if it is not twisted.
   * @param {Page.Handle} pin
   */
  freeOf({ p }) {
    return freeTurn(this.sync.mesh, p[0], longest(known(this.view.size)) / 8);
  }

  /**
   * The document with a pin turned by degrees, to a multiple of `step`; undefined, with a message,
   * if the focus does not permit it.
   * @param {Page.Document} document
   * @param {number} index
   * @param {number} by
   * @param {Page.Turn} free
   * @param {number} [step]
   * @returns {Page.Document | undefined}
   */
  twistedBy(document, index, by, free, step = 0) {
    if (!edits.mayTwist(document)) return this.#sayNoTwist();
    const from = document.handles[index].twist?.angle ?? free.angle;
    const angle = step ? Math.round((from + by) / step) * step : from + by;
    return edits.withTwist(document, index, angle, free, known(this.view.size));
  }

  /** @returns {undefined} */
  #sayNoTwist() {
    this.say(
      edits.takesPinsOnly(this.state.document)
        ? PINS_ONLY
        : "To twist a pin, set the focus to 0.5 or more",
    );
  }

  /**
   * Twists a pin to an angle, in degrees; null removes the twist.
   * @param {number} index
   * @param {number | null} angle
   */
  twistTo(index, angle) {
    const { document } = this.state;
    if (angle !== null && !edits.mayTwist(document)) return this.#sayNoTwist();
    this.edit(
      edits.withTwist(
        document,
        index,
        angle,
        this.freeOf(document.handles[index]),
        known(this.view.size),
      ),
    );
    this.sayTwist(index);
  }

  /** @param {number} degrees */
  rotate(degrees) {
    const { document, selection } = this.state;
    const index =
      selection.length === 1
        ? document.handles.findIndex((h) => String(h.id) === selection[0])
        : -1;
    if (canTwist(document.handles[index])) {
      const next = this.twistedBy(document, index, degrees, this.freeOf(document.handles[index]));
      if (!next) return;
      this.edit(next, { tag: `rotate ${selection}` });
      return this.sayTwist(index);
    }
    const posed = edits.posedPlaces(document, selection);
    if (posed.length < 2) return;
    this.edit(
      edits.rotated(
        document,
        selection,
        edits.circleOf(posed).centre,
        (degrees * Math.PI) / 180,
        known(this.view.size),
      ),
      { tag: `rotate ${selection}` },
    );
    this.say(`Rotated by ${degrees} degrees`);
  }

  remove(selection = this.state.selection) {
    const { document } = this.state;
    const next = edits.removed(document, selection);
    const gone = document.handles.length - next.handles.length;
    const kept = this.#keepFocus(next);
    this.edit(kept, { select: [] });
    this.say(
      gone
        ? `${count(gone, "handle")} deleted${this.#focusKept(kept === next)}`
        : "Point of the path deleted",
    );
    if (
      !globalThis.document.activeElement?.isConnected ||
      globalThis.document.activeElement === globalThis.document.body
    )
      this.view.stage.focus({ preventScroll: true });
  }

  putBack(selection = this.state.selection) {
    this.edit(edits.putBack(this.state.document, selection));
    this.say("Put back");
  }

  /**
   * Puts the selection in front of what it overlaps, or behind it.
   * @param {boolean} isFront
   */
  bring(isFront) {
    const { document, selection } = this.state;
    const next = edits.brought(document, selection, isFront);
    const where = isFront ? "in front" : "at the back";
    if (next === document) return this.say(`It is ${where} already`);
    this.edit(next);
    this.say(`It is ${where} where the picture overlaps itself`);
  }

  /** Exchanges rest and pose of all handles. */
  async swap() {
    const { document } = this.state;
    const { align } = document;
    this.edit(edits.swapped(document), { select: [] });
    this.say("Rest and pose are exchanged");
    if (align) await this.align(align.by);
  }

  /**
   * Aligns the posed handles by the best map of a class (align.js).
   * @param {Page.AlignClass} by
   */
  async align(by) {
    const { document, picture } = this.state;
    const next = await this.sync.aligned(document, by, known(picture));
    if (!next || this.state.document !== document) return;
    this.edit(next);
    this.say(by === "none" ? "The pose is not aligned" : "The pose is aligned");
  }

  selectAll() {
    this.store.do("select", { keys: this.all });
    this.say(`${count(this.state.selection.length, "handle")} selected`);
  }

  get all() {
    return this.state.document.handles.map((h) => String(h.id));
  }

  clear() {
    this.remove(this.all);
  }

  /** Adds a handle of the selected kind in the middle of the view. */
  addInTheMiddle() {
    const size = known(this.view.size);
    const middle = this.view
      .toPicture(this.view.stageSize.map((side) => side / 2))
      .map((c, axis) => Math.min(size[axis], Math.max(0, c)));
    const reach = Math.min(...size) / 8;
    /** @type {Record<Page.HandleKind, Page.Place[]>} */
    const offsets = {
      point: [[0, 0]],
      line: [
        [-reach, 0],
        [reach, 0],
      ],
      path: [
        [-reach, 0],
        [0, -reach / 2],
        [reach, 0],
      ],
    };
    const { tool } = this.state;
    const kind = isRegionTool(tool) ? "point" : tool;
    const places = offsets[kind].map(([dx, dy]) => [middle[0] + dx, middle[1] + dy]);
    this.add(/** @type {Page.Place[]} */ (places), Infinity);
  }

  pinBorder() {
    const places = edits.borderPath(...known(this.view.size));
    const { document } = this.state;
    if (document.handles.some((h) => JSON.stringify(h.p) === JSON.stringify(places)))
      return this.say("The border is already pinned");
    const made = known(edits.added(document, places, places));
    const next = this.#keepFocus(made.document);
    this.edit(next, { select: [] });
    this.say(`The border is pinned${this.#focusKept(next === made.document)}`);
  }

  /**
   * While something is drawn, undo takes back its last point.
   * @param {boolean} back
   */
  undo(back) {
    const { past, future, before, phase, draft, tool } = this.state;
    if (before || phase === "uploading") return;
    if (back && draft.length) {
      this.store.do("draft", { places: draft.slice(0, -1) });
      return this.say(`${edits.toolName(tool)}: ${count(draft.length - 1, "point")}`);
    }
    if (!(back ? past : future).length) return this.step(back);
    this.store.do(back ? "undo" : "redo");
    this.say(back ? "Undone" : "Redone");
  }

  escape() {
    const { before, draft, arm, selection, playing } = this.state;
    if (playing !== null) this.store.do("play", { playing: null });
    else if (before) this.store.do("dragCancel");
    else if (draft.length) this.store.do("draft", { places: [] });
    else if (arm) this.store.do("arm", { arm: "" });
    else if (selection.length) this.store.do("select", { keys: [] });
    else {
      this.store.do("cross", { place: null });
      this.view.stage.focus({ preventScroll: true });
    }
  }

  /**
   * A click on a handle.
   * @param {{ handle: Page.Handle, vertex: number | null }} named
   * @param {boolean} adds
   */
  choose({ handle, vertex }, adds) {
    const key = keyOf(handle, vertex);
    if (adds || this.state.more) this.store.do("toggle", { key });
    else this.store.do("select", { keys: [key] });
  }

  /** @param {number} index */
  sayTwist(index) {
    const angle = angleOf(this.state.document.handles[index]);
    this.say(
      angle === null
        ? `Point ${index + 1} is not twisted`
        : `Point ${index + 1} twisted to ${angle} degrees`,
    );
  }

  sayWhere() {
    const { document, selection } = this.state;
    const posed = edits.posedPlaces(document, selection);
    if (!posed.length) return;
    const index = document.handles.findIndex((h) => h.id === Number(selection[0].split(".")[0]));
    const name = `${edits.kindName(document.handles[index])} ${index + 1}`;
    this.say(
      selection.length === 1
        ? `${name} at ${places(posed)}`
        : `${count(selection.length, "handle")} moved`,
    );
  }
}
