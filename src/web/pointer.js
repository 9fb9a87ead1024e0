// Mouse, pen and touch on the stage. A gesture begins with pointerdown and owns the pointer until
// pointerup or pointercancel. A second finger cancels it and begins a pinch.

import { known } from "./dom.js";
import { brought, circleOf, isOutlined, posedPlaces, rotated, translated } from "./edits.js";
import { keyOf } from "./handles.js";
import { isRegionTool } from "./region.js";

/**
 * Maximum movement of a click, CSS px.
 * @type {Record<string, number>}
 */
const STILL = { mouse: 3, pen: 5, touch: 8 };
/** Maximum time and distance between the clicks of a double click. */
const DOUBLE = { time: 400, away: 8 };
/** Zoom factor per notch of the wheel, approximately. */
const WHEEL = 1.0018;

/**
 * What a gesture does: `press` at once; `begin`, `move` and `end` if the pointer moves more than
 * `still` px; otherwise `click`; `cancel` if it is lost.
 *
 * @typedef {{
 *   still?: number,
 *   press?: (at: Page.Place) => unknown,
 *   begin?: () => unknown,
 *   move?: (at: Page.Place, event: PointerEvent) => unknown,
 *   end?: (at: Page.Place) => unknown,
 *   click?: (at: Page.Place, event: PointerEvent) => unknown,
 *   cancel?: () => unknown,
 * }} Gesture
 */

/** @typedef {{ still: number, id: number, begun: Page.Place, moved: boolean }} Held */

export class Pointer {
  spaceHeld = false;
  /** Whether a pan happened since Space was pressed. */
  spaceUsed = false;

  /** @type {Gesture & Held | null} */
  #gesture = null;
  /** @type {DOMRect | null} */
  #box = null;
  /** @type {Map<number, Page.Place>} */
  #fingers = new Map(); // pointerId to [x, y]
  /** @type {{ zoom: number, pan: Page.Place, apart: number, middle: Page.Place } | null} */
  #pinch = null;
  /** @type {{ time: number, at: Page.Place }} */
  #lastClick = { time: 0, at: [0, 0] };

  /**
   * @param {HTMLElement} stage
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Page.Handles} handles
   * @param {Page.UserActions} actions
   * @param {import("./loupe.js").Loupe} loupe
   * @param {import("./regiontool.js").RegionTool} region
   */
  constructor(stage, store, view, handles, actions, loupe, region) {
    this.stage = stage;
    this.store = store;
    this.view = view;
    this.handles = handles;
    this.actions = actions;
    this.loupe = loupe;
    this.region = region;
    stage.addEventListener("pointerdown", (event) => this.#down(event));
    stage.addEventListener("pointermove", (event) => this.#move(event));
    stage.addEventListener("pointerup", (event) => this.#up(event));
    stage.addEventListener("pointercancel", (event) => this.#lost(event));
    stage.addEventListener(
      "lostpointercapture",
      (event) => this.#gesture?.id === event.pointerId && this.#lost(event),
    );
    stage.addEventListener("pointerleave", () => this.#hover(null));
    stage.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    stage.addEventListener(
      "contextmenu",
      (event) => event.pointerType === "touch" && event.preventDefault(),
    );
    // Assistive technology activates a handle by a click without a pointer.
    stage.addEventListener("click", (event) => {
      const named = event.detail === 0 && handles.named(event.target);
      if (named) actions.choose(named, event.shiftKey);
    });
  }

  /** Whether a gesture is active. */
  get busy() {
    return this.#gesture !== null || this.#pinch !== null;
  }

  cancel() {
    this.#gesture?.cancel?.();
    this.#end();
  }

  /**
   * Position in the stage. The stage cannot move during a gesture, so its rectangle is read once.
   * @param {MouseEvent} event
   * @returns {Page.Place}
   */
  #at(event) {
    const { left, top } =
      (this.#gesture || this.#pinch) && this.#box
        ? this.#box
        : (this.#box = this.stage.getBoundingClientRect());
    return [event.clientX - left, event.clientY - top];
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (!this.view.size || event.button === 2) return;
    if (this.store.state.playing !== null) return this.actions.escape();
    const at = this.#at(event);
    if (event.pointerType === "touch") {
      this.#fingers.set(event.pointerId, at);
      if (this.#fingers.size > 1) return this.#beginPinch(event);
    }
    if (this.#gesture || this.#pinch) return;
    this.stage.setPointerCapture(event.pointerId);
    event.preventDefault(); // prevent text selection; the focus is set here
    this.store.do("cross", { place: null });
    this.#hover(null);
    const gesture = this.#begin(event, at);
    const held = {
      still: STILL[event.pointerType] ?? STILL.mouse,
      ...gesture,
      id: event.pointerId,
      begun: at,
      moved: false,
    };
    this.#gesture = held;
    held.press?.(at);
  }

  /**
   * @param {PointerEvent} event
   * @param {Page.Place} at
   * @returns {Gesture}
   */
  #begin(event, at) {
    const { state } = this.store;
    const kind = event.pointerType;
    if (event.button === 1 || this.spaceHeld) return this.#panning();
    if (state.compare) return this.#comparing();
    if (state.arm || state.draft.length) return this.#placing(kind);
    if (isRegionTool(state.tool)) return this.#outlining(kind, state.tool === "brush");
    const hit = this.handles.hit(at, kind);
    if (hit && "knob" in hit) return hit.pin ? this.#twisting(hit.pin) : this.#turning();
    if (hit) return this.#dragging(hit, event.shiftKey, kind);
    if (event.shiftKey || state.tool === "point") return this.#marquee(event.shiftKey);
    return this.#placing(kind, state.tool === "line");
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const at = this.#at(event);
    if (this.#fingers.has(event.pointerId)) this.#fingers.set(event.pointerId, at);
    if (this.#pinch) return this.#movePinch();
    const gesture = this.#gesture;
    if (!gesture) return event.pointerType === "mouse" && this.#hover(at);
    if (gesture.id !== event.pointerId) return;
    if (
      !gesture.moved &&
      Math.hypot(at[0] - gesture.begun[0], at[1] - gesture.begun[1]) < gesture.still
    )
      return;
    if (!gesture.moved) {
      gesture.moved = true;
      gesture.begin?.();
    }
    gesture.move?.(at, event);
  }

  /** @param {PointerEvent} event */
  #up(event) {
    this.#fingers.delete(event.pointerId);
    if (this.#pinch) {
      if (this.#fingers.size < 2) this.#pinch = null;
      return;
    }
    const gesture = this.#gesture;
    if (gesture?.id !== event.pointerId) return;
    this.#end();
    if (gesture.moved) gesture.end?.(this.#at(event));
    else gesture.click?.(this.#at(event), event);
  }

  /** @param {PointerEvent} event */
  #lost(event) {
    this.#fingers.delete(event.pointerId);
    if (this.#pinch && this.#fingers.size < 2) this.#pinch = null;
    if (this.#gesture?.id !== event.pointerId) return;
    this.cancel();
  }

  #end() {
    this.#gesture = null;
    this.loupe.hide();
    this.handles.marquee = null;
    this.handles.turning = null;
    this.handles.draw();
    delete this.stage.dataset.gesture;
  }

  // Gestures

  /**
   * @param {Page.Named} hit
   * @param {boolean} adds
   * @param {string} kind
   * @returns {Gesture}
   */
  #dragging(hit, adds, kind) {
    const key = keyOf(hit.handle, hit.vertex);
    const selected = () =>
      this.store.state.selection.includes(key) ||
      this.store.state.selection.includes(String(hit.handle.id));
    /** @type {Page.Document} */
    let before;
    return {
      press: () => this.handles.focus(hit.index, hit.handle.p.length === 1 ? null : hit.vertex),
      begin: () => {
        if (!selected()) this.store.do("select", { keys: [key] });
        this.store.do("dragBegin");
        const { document, selection } = this.store.state;
        // What is in hand is not hidden by what it is moved over.
        before = isOutlined(document) ? brought(document, selection, true) : document;
        this.stage.dataset.gesture = "drag";
      },
      move: (at) => {
        const [dx, dy] = at.map(
          (c, axis) => (c - known(this.#gesture).begun[axis]) / this.view.zoom,
        );
        this.store.do("drag", { document: translated(before, this.store.state.selection, dx, dy) });
        const dragged = this.store.state.document.handles[hit.index];
        this.loupe.show(
          hit.vertex === null && dragged.q.length > 1
            ? this.view.toPicture(at)
            : dragged.q[hit.vertex ?? 0],
          at,
          kind,
        );
      },
      end: () => {
        this.store.do("dragEnd");
        this.actions.sayWhere();
      },
      cancel: () => this.store.do("dragCancel"),
      click: () => this.actions.choose(hit, adds),
    };
  }

  /**
   * Turns a pin about itself. Turns are counted from the angle that it has, or had without a twist.
   * @param {Page.Handle} pin
   * @returns {Gesture}
   */
  #twisting(pin) {
    const { document } = this.store.state;
    const index = document.handles.indexOf(pin);
    const free = this.actions.freeOf(pin); // before the twist changes the mesh
    const middle = this.view.toStage(pin.q[0]);
    /** @type {(at: Page.Place) => number} */
    const angleOf = (at) => (Math.atan2(at[1] - middle[1], at[0] - middle[0]) * 180) / Math.PI;
    return {
      still: 1,
      press: () => this.handles.knob.focus({ preventScroll: true }),
      begin: () => {
        this.store.do("dragBegin");
        this.stage.dataset.gesture = "drag";
      },
      move: (at, { shiftKey }) => {
        const by = angleOf(at) - angleOf(known(this.#gesture).begun);
        const next = this.actions.twistedBy(document, index, by, free, shiftKey ? 15 : 0);
        if (next) this.store.do("drag", { document: next });
      },
      end: () => {
        this.store.do("dragEnd");
        this.actions.sayTwist(index);
      },
      cancel: () => this.store.do("dragCancel"),
    };
  }

  /** @returns {Gesture} */
  #turning() {
    const { document, selection } = this.store.state;
    const [circle, size] = [circleOf(posedPlaces(document, selection)), known(this.view.size)];
    /** @type {(at: Page.Place) => number} */
    const angleOf = (at) => {
      const middle = this.view.toStage(circle.centre);
      return Math.atan2(at[1] - middle[1], at[0] - middle[0]);
    };
    return {
      still: 1,
      press: () => this.handles.knob.focus({ preventScroll: true }),
      begin: () => this.store.do("dragBegin"),
      move: (at, { shiftKey }) => {
        const turned = angleOf(at) - angleOf(known(this.#gesture).begun);
        const angle = shiftKey ? Math.round(turned / (Math.PI / 12)) * (Math.PI / 12) : turned;
        this.handles.turning = { ...circle, angle };
        this.store.do("drag", {
          document: rotated(document, selection, circle.centre, angle, size),
        });
      },
      end: () => {
        this.store.do("dragEnd");
        this.actions.sayWhere();
      },
      cancel: () => this.store.do("dragCancel"),
    };
  }

  /**
   * At an empty position: a click adds, a drag selects.
   * @param {boolean} adds
   * @returns {Gesture}
   */
  #marquee(adds) {
    const { selection } = this.store.state;
    const kept = adds ? selection : [];
    return {
      press: () => this.stage.focus({ preventScroll: true }),
      move: (at) => {
        this.handles.marquee = [known(this.#gesture).begun, at];
        const inside = this.handles.inside(this.handles.marquee);
        this.store.do("select", { keys: [...new Set([...kept, ...inside])] });
        this.handles.draw();
      },
      cancel: () => this.store.do("select", { keys: selection }),
      click: (at) => this.#clickOnNothing(at, adds),
    };
  }

  /**
   * @param {Page.Place} at
   * @param {boolean} adds
   */
  #clickOnNothing(at, adds) {
    const place = this.view.toPicture(at);
    if (adds || !this.actions.inPicture(place))
      return adds || this.store.do("select", { keys: [] });
    this.actions.place(place);
  }

  /**
   * The next vertex of a line or path, or the target of the selection.
   * @param {string} kind
   * @param {boolean} [drags]
   * @returns {Gesture}
   */
  #placing(kind, drags = false) {
    /** @type {(at: Page.Place) => boolean} */
    const isDouble = (at) => {
      const { time, at: before } = this.#lastClick;
      return (
        performance.now() - time < DOUBLE.time &&
        Math.hypot(at[0] - before[0], at[1] - before[1]) < DOUBLE.away
      );
    };
    /** @type {(at: Page.Place) => void} */
    const click = (at) => {
      const { tool, draft, arm } = this.store.state;
      const place = this.view.toPicture(at);
      if (!arm && (tool === "path" || tool === "lasso") && draft.length && isDouble(at))
        return this.actions.finish();
      this.#lastClick = { time: performance.now(), at };
      if (!draft.length && !arm && tool !== "lasso" && !this.actions.inPicture(place))
        return this.store.do("select", { keys: [] });
      this.actions.place(place);
      if (kind === "mouse") this.#hover(at);
    };
    return {
      press: () => this.stage.focus({ preventScroll: true }),
      // A line may be drawn by one drag.
      begin: () => drags && this.actions.place(this.view.toPicture(known(this.#gesture).begun)),
      move: (at) => this.#hover(at),
      end: (at) => (drags ? this.actions.place(this.view.toPicture(at)) : click(at)),
      cancel: () => drags && this.store.do("draft", { places: [] }),
      click,
    };
  }

  /**
   * The brush draws from the press on; the lasso draws if it is dragged, and a click is the first
   * of its corners.
   * @param {string} kind
   * @param {boolean} brush
   * @returns {Gesture}
   */
  #outlining(kind, brush) {
    /** @type {Page.Place[]} */
    const places = [];
    /** @type {(at: Page.Place) => void} */
    const put = (at) => {
      places.push(this.view.toPicture(at));
      this.region.draw(places);
      if (brush) this.region.hover(at);
    };
    const end = () => {
      this.region.draw([]);
      this.actions.outline(places);
      if (kind !== "mouse") this.region.hover(null);
    };
    const focus = () => this.stage.focus({ preventScroll: true });
    return {
      ...(brush ? { still: 1, click: end } : { click: this.#placing(kind).click }),
      press: (at) => {
        focus();
        if (brush) put(at);
      },
      begin: () => brush || put(known(this.#gesture).begun),
      move: put,
      end,
      cancel: () => this.region.draw([]),
    };
  }

  /** @returns {Gesture} */
  #panning() {
    let from = this.view.pan;
    return {
      still: 1,
      press: () => {
        from = this.view.pan;
        this.spaceUsed = true;
        this.stage.dataset.gesture = "pan";
      },
      move: (at) => {
        const { begun } = known(this.#gesture);
        this.view.panBy(
          from[0] + at[0] - begun[0] - this.view.pan[0],
          from[1] + at[1] - begun[1] - this.view.pan[1],
        );
      },
    };
  }

  /** @returns {Gesture} */
  #comparing() {
    /** @type {(at: Page.Place) => void} */
    const to = ([x]) => {
      const share = (100 * (x - this.view.pan[0])) / (this.view.zoom * known(this.view.size)[0]);
      this.store.do("show", { what: { compareAt: Math.min(100, Math.max(0, Math.round(share))) } });
    };
    return { still: 1, press: to, move: to };
  }

  // Two fingers

  /** @param {PointerEvent} event */
  #beginPinch(event) {
    event.preventDefault();
    this.cancel();
    const [a, b] = [...this.#fingers.values()];
    this.#pinch = {
      zoom: this.view.zoom,
      pan: this.view.pan,
      apart: Math.hypot(a[0] - b[0], a[1] - b[1]),
      middle: middleOf(a, b),
    };
    this.stage.setPointerCapture(event.pointerId);
  }

  #movePinch() {
    const [a, b] = [...this.#fingers.values()];
    if (!b) return;
    const { zoom, pan, apart, middle } = known(this.#pinch);
    const now = middleOf(a, b);
    const next = (zoom * Math.hypot(a[0] - b[0], a[1] - b[1])) / Math.max(1, apart);
    this.view.zoomTo(next, now);
    const factor = this.view.zoom / zoom;
    const wish = now.map((c, axis) => c - (middle[axis] - pan[axis]) * factor);
    this.view.panBy(wish[0] - this.view.pan[0], wish[1] - this.view.pan[1]);
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    if (!this.view.size) return;
    event.preventDefault();
    if (event.shiftKey && !event.ctrlKey)
      return this.view.panBy(-(event.deltaX || event.deltaY), 0);
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    // A touchpad pinch arrives as a wheel event with Ctrl, in smaller steps.
    const step = Math.max(-240, Math.min(240, event.deltaY * lines * (event.ctrlKey ? 5 : 1)));
    this.view.zoomTo(this.view.zoom * WHEEL ** -step, this.#at(event));
  }

  /**
   * The preview of the next vertex while a line is drawn.
   * @param {Page.Place | null} at
   */
  #hover(at) {
    this.region.hover(at);
    const drawing = at && this.store.state.draft.length > 0;
    const next = drawing ? at : null;
    if (next === this.handles.pointer) return;
    this.handles.pointer = next;
    this.handles.draw();
  }
}

/** @type {(a: Page.Place, b: Page.Place) => Page.Place} */
const middleOf = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
