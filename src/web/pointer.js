// Mouse, pen and touch on the stage. A gesture begins with pointerdown and owns the pointer until
// pointerup or pointercancel. A second finger cancels it and begins a pinch.

import { circleOf, posedPlaces, rotated, translated } from "./edits.js";
import { keyOf } from "./handles.js";
import { isRegionTool } from "./region.js";

/** Maximum movement of a click, CSS px. */
const STILL = { mouse: 3, pen: 5, touch: 8 };
/** Maximum time and distance between the clicks of a double click. */
const DOUBLE = { time: 400, away: 8 };
/** Zoom factor per notch of the wheel, approximately. */
const WHEEL = 1.0018;

export class Pointer {
  spaceHeld = false;
  /** Whether a pan happened since Space was pressed. */
  spaceUsed = false;

  #gesture = null;
  #box = null;
  #fingers = new Map(); // pointerId to [x, y]
  #pinch = null;
  #lastClick = { time: 0, at: [0, 0] };

  constructor(stage, store, view, handles, actions, loupe, region) {
    Object.assign(this, { stage, store, view, handles, actions, loupe, region });
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
   */
  #at(event) {
    const { left, top } =
      (this.#gesture || this.#pinch) && this.#box
        ? this.#box
        : (this.#box = this.stage.getBoundingClientRect());
    return [event.clientX - left, event.clientY - top];
  }

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
    this.#gesture = {
      still: STILL[event.pointerType] ?? STILL.mouse,
      ...gesture,
      id: event.pointerId,
      begun: at,
      moved: false,
    };
    this.#gesture.press?.(at);
  }

  #begin(event, at) {
    const { state } = this.store;
    const kind = event.pointerType;
    if (event.button === 1 || this.spaceHeld) return this.#panning();
    if (state.compare) return this.#comparing();
    if (state.arm || state.draft.length) return this.#placing(kind);
    if (isRegionTool(state.tool)) return this.#outlining(kind, state.tool === "brush");
    const hit = this.handles.hit(at, kind);
    if (hit?.pin) return this.#twisting(hit.pin);
    if (hit?.knob) return this.#turning();
    if (hit) return this.#dragging(hit, event.shiftKey, kind);
    if (event.shiftKey || state.tool === "point") return this.#marquee(event.shiftKey);
    return this.#placing(kind, state.tool === "line");
  }

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
    gesture.last = at;
    gesture.move?.(at, event);
  }

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

  #dragging(hit, adds, kind) {
    const key = keyOf(hit.handle, hit.vertex);
    const selected = () =>
      this.store.state.selection.includes(key) ||
      this.store.state.selection.includes(String(hit.handle.id));
    let before;
    return {
      press: () => this.handles.focus(hit.index, hit.handle.p.length === 1 ? null : hit.vertex),
      begin: () => {
        if (!selected()) this.store.do("select", { keys: [key] });
        this.store.do("dragBegin");
        before = this.store.state.document;
        this.stage.dataset.gesture = "drag";
      },
      move: (at) => {
        const [dx, dy] = at.map((c, axis) => (c - this.#gesture.begun[axis]) / this.view.zoom);
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
   */
  #twisting(pin) {
    const { document } = this.store.state;
    const index = document.handles.indexOf(pin);
    const free = this.actions.freeOf(pin); // before the twist changes the mesh
    const middle = this.view.toStage(pin.q[0]);
    const angleOf = (at) => (Math.atan2(at[1] - middle[1], at[0] - middle[0]) * 180) / Math.PI;
    return {
      still: 1,
      press: () => this.handles.knob.focus({ preventScroll: true }),
      begin: () => {
        this.store.do("dragBegin");
        this.stage.dataset.gesture = "drag";
      },
      move: (at, { shiftKey }) => {
        const by = angleOf(at) - angleOf(this.#gesture.begun);
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

  #turning() {
    const { document, selection } = this.store.state;
    const circle = circleOf(posedPlaces(document, selection));
    const angleOf = (at) => {
      const middle = this.view.toStage(circle.centre);
      return Math.atan2(at[1] - middle[1], at[0] - middle[0]);
    };
    return {
      still: 1,
      press: () => this.handles.knob.focus({ preventScroll: true }),
      begin: () => this.store.do("dragBegin"),
      move: (at, { shiftKey }) => {
        const turned = angleOf(at) - angleOf(this.#gesture.begun);
        const angle = shiftKey ? Math.round(turned / (Math.PI / 12)) * (Math.PI / 12) : turned;
        this.handles.turning = { ...circle, angle };
        this.store.do("drag", { document: rotated(document, selection, circle.centre, angle) });
      },
      end: () => {
        this.store.do("dragEnd");
        this.actions.sayWhere();
      },
      cancel: () => this.store.do("dragCancel"),
    };
  }

  /** At an empty position: a click adds, a drag selects. */
  #marquee(adds) {
    const { selection } = this.store.state;
    const kept = adds ? selection : [];
    return {
      press: () => this.stage.focus({ preventScroll: true }),
      move: (at) => {
        this.handles.marquee = [this.#gesture.begun, at];
        const inside = this.handles.inside(this.handles.marquee);
        this.store.do("select", { keys: [...new Set([...kept, ...inside])] });
        this.handles.draw();
      },
      cancel: () => this.store.do("select", { keys: selection }),
      click: (at) => this.#clickOnNothing(at, adds),
    };
  }

  #clickOnNothing(at, adds) {
    const place = this.view.toPicture(at);
    if (adds || !this.actions.inPicture(place))
      return adds || this.store.do("select", { keys: [] });
    this.actions.place(place);
  }

  /** The next vertex of a line or path, or the target of the selection. */
  #placing(kind, drags = false) {
    const isDouble = (at) => {
      const { time, at: before } = this.#lastClick;
      return (
        performance.now() - time < DOUBLE.time &&
        Math.hypot(at[0] - before[0], at[1] - before[1]) < DOUBLE.away
      );
    };
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
      begin: () => drags && this.actions.place(this.view.toPicture(this.#gesture.begun)),
      move: (at) => this.#hover(at),
      end: (at) => (drags ? this.actions.place(this.view.toPicture(at)) : click(at)),
      cancel: () => drags && this.store.do("draft", { places: [] }),
      click,
    };
  }

  /**
   * The brush draws from the press on; the lasso draws if it is dragged, and a click is the first
   * of its corners.
   */
  #outlining(kind, brush) {
    const places = [];
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
      begin: () => brush || put(this.#gesture.begun),
      move: put,
      end,
      cancel: () => this.region.draw([]),
    };
  }

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
        const { begun } = this.#gesture;
        this.view.panBy(
          from[0] + at[0] - begun[0] - this.view.pan[0],
          from[1] + at[1] - begun[1] - this.view.pan[1],
        );
      },
    };
  }

  #comparing() {
    const to = ([x]) => {
      const share = (100 * (x - this.view.pan[0])) / (this.view.zoom * this.view.size[0]);
      this.store.do("show", { what: { compareAt: Math.min(100, Math.max(0, Math.round(share))) } });
    };
    return { still: 1, press: to, move: to };
  }

  // Two fingers

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
    const { zoom, pan, apart, middle } = this.#pinch;
    const now = middleOf(a, b);
    const next = (zoom * Math.hypot(a[0] - b[0], a[1] - b[1])) / Math.max(1, apart);
    this.view.zoomTo(next, now);
    const factor = this.view.zoom / zoom;
    const wish = now.map((c, axis) => c - (middle[axis] - pan[axis]) * factor);
    this.view.panBy(wish[0] - this.view.pan[0], wish[1] - this.view.pan[1]);
  }

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

  /** The preview of the next vertex while a line is drawn. */
  #hover(at) {
    this.region.hover(at);
    const drawing = at && this.store.state.draft.length > 0;
    const next = drawing ? at : null;
    if (next === this.handles.pointer) return;
    this.handles.pointer = next;
    this.handles.draw();
  }
}

const middleOf = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
