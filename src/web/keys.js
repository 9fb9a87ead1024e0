// The keyboard. Keys with Ctrl and characters work everywhere except in text fields and lists;
// characters can be switched off. Arrows, Enter, Space and Delete work with the focus in the stage
// or nowhere.

import { known } from "./dom.js";
import { isRegionTool } from "./region.js";

/** @type {Record<string, Page.Place>} */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const NUDGE = [1, 10];
const CROSS = [10, 1];
const PAN = 40;
const TURN = 5;

export class Keys {
  #crossMoved = false;

  /**
   * `does`: the actions of the buttons, by name.
   * @param {HTMLElement} stage
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {Page.Handles} handles
   * @param {import("./pointer.js").Pointer} pointer
   * @param {Page.UserActions} actions
   * @param {Page.Does} does
   * @param {() => boolean} singleKeys
   * @param {{ root?: Document | ShadowRoot, signal?: AbortSignal }} [where] what hears the keys
   */
  constructor(
    stage,
    store,
    view,
    handles,
    pointer,
    actions,
    does,
    singleKeys,
    { root = document, signal } = {},
  ) {
    this.stage = stage;
    this.store = store;
    this.view = view;
    this.handles = handles;
    this.pointer = pointer;
    this.actions = actions;
    this.does = does;
    this.singleKeys = singleKeys;
    this.root = root;
    /** @type {(act: (event: KeyboardEvent) => void) => EventListener} */
    const key = (act) => (event) => act(/** @type {KeyboardEvent} */ (event));
    const down = key((event) => this.#down(event));
    const up = key((event) => this.#up(event));
    root.addEventListener("keydown", down, { signal });
    root.addEventListener("keyup", up, { signal });
    globalThis.addEventListener("blur", () => this.#release(), { signal });
    // Tab pans to the focused handle.
    stage.addEventListener("focusin", (event) => {
      const { target } = event;
      const seen = target instanceof Element && target.matches(":focus-visible");
      const named = seen && handles.named(target);
      if (named) view.reveal(named.handle.q[named.vertex ?? 0]);
    });
  }

  /** @param {KeyboardEvent} event */
  #down(event) {
    if (event.defaultPrevented || this.root.querySelector("dialog[open]")) return;
    const open = this.store.state.phase === "open";
    const target = event.target instanceof Element ? event.target : null;
    const text = target?.closest(
      "input:not([type=radio], [type=checkbox], [type=range]), textarea, select",
    );
    if (event.ctrlKey || event.metaKey) {
      if (!event.altKey && (!text || event.key.toLowerCase() === "o") && this.#command(event, open))
        event.preventDefault();
      return;
    }
    if (text) return;
    const inStage = this.stage.contains(target);
    const free = inStage || target === document.body || target === document.documentElement;
    if (event.key === "?" && this.singleKeys()) return this.#take(event, this.does.help);
    if (!open) return;
    if (!free) return this.#character(event);
    if (this.#moving(event, inStage) || this.#acting(event, inStage)) event.preventDefault();
  }

  /**
   * @param {KeyboardEvent} event
   * @param {boolean} open
   */
  #command(event, open) {
    const key = event.key.toLowerCase();
    if (key === "o") this.does.pick();
    else if (key === "z") this.actions.undo(!event.shiftKey);
    else if (key === "y") this.actions.undo(false);
    else if (!open) return false;
    else if (key === "a") this.actions.selectAll();
    else return false;
    return true;
  }

  /**
   * A key that the focused control does not use.
   * @param {KeyboardEvent} event
   */
  #character(event) {
    if (event.key === "Escape") this.actions.escape();
    if (event.key.length > 1 || event.key === " " || !this.singleKeys()) return;
    if (this.#single(event.key.toLowerCase(), event.repeat)) event.preventDefault();
  }

  /**
   * @param {KeyboardEvent} event
   * @param {() => void} act
   */
  #take(event, act) {
    event.preventDefault();
    act();
  }

  /**
   * Arrow keys, with or without a selection.
   * @param {KeyboardEvent} event
   * @param {boolean} inStage
   */
  #moving(event, inStage) {
    const arrow = ARROWS[event.key];
    if (!arrow) return false;
    const [dx, dy] = arrow;
    const coarse = event.shiftKey ? 1 : 0;
    const named = this.#focused(event);
    if (event.altKey) this.view.panBy(-dx * PAN, -dy * PAN);
    else if (this.store.state.compare)
      this.store.do("show", {
        what: {
          compareAt: Math.min(
            100,
            Math.max(0, this.store.state.compareAt + dx * (coarse ? 10 : 1)),
          ),
        },
      });
    else if (event.target === this.handles.knob) this.actions.rotate((dx || dy) * NUDGE[coarse]);
    else if (named && this.#adopts(named))
      this.actions.nudge(dx * NUDGE[coarse], dy * NUDGE[coarse]);
    else if (
      this.store.state.selection.length &&
      !this.store.state.draft.length &&
      !this.store.state.arm
    )
      this.actions.nudge(dx * NUDGE[coarse], dy * NUDGE[coarse]);
    else if (inStage) this.#moveCross(dx * CROSS[coarse], dy * CROSS[coarse]);
    else return false;
    return true;
  }

  /**
   * The focused handle; none while a tool for the region hides the handles.
   * @param {Pick<KeyboardEvent, "target">} event
   */
  #focused(event) {
    return isRegionTool(this.store.state.tool) ? null : this.handles.named(event.target);
  }

  /**
   * Selects the focused handle, unless the selection contains it: arrow keys move the focused
   * handle.
   * @param {Page.Named} named
   */
  #adopts({ handle, vertex }) {
    const { state } = this.store;
    if (state.arm || state.draft.length) return false;
    const keys = [String(handle.id), `${handle.id}.${vertex}`];
    if (!state.selection.some((key) => keys.includes(key)))
      this.actions.choose({ handle, vertex }, false);
    return true;
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  #moveCross(dx, dy) {
    const size = known(this.view.size);
    const from =
      this.store.state.cross ??
      this.view.toPicture(this.view.stageSize.map((side) => side / 2)).map((c) => Math.round(c));
    const by = [dx, dy];
    const place = from.map((c, axis) => Math.min(size[axis], Math.max(0, c + by[axis])));
    this.#crossMoved = true;
    this.store.do("cross", { place });
    this.view.reveal(place);
    this.actions.say(`${place[0]}, ${place[1]}`);
  }

  /** @param {KeyboardEvent} event */
  #enter(event) {
    const named = this.#focused(event);
    const { draft, tool, arm, cross } = this.store.state;
    if (named && !arm && !draft.length) return this.actions.choose(named, event.shiftKey);
    if (!cross) return draft.length ? this.actions.finish() : this.#moveCross(0, 0);
    // Twice at the same position: the path is complete.
    if ((tool === "path" || tool === "lasso") && draft.length && !arm && !this.#crossMoved)
      return this.actions.finish();
    this.#crossMoved = false;
    const keep = tool !== "point" && draft.length + 1 < (tool === "line" ? 2 : Infinity);
    this.actions.place(cross);
    // The cross stays while drawing. A new handle has the focus, so that arrow keys move it.
    if (!keep || arm) this.store.do("cross", { place: null });
  }

  /**
   * @param {KeyboardEvent} event
   * @param {boolean} inStage
   */
  #acting(event, inStage) {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const { state } = this.store;
    if (key === "Escape") {
      if (this.pointer.busy) this.pointer.cancel();
      else this.actions.escape();
    } else if (key === "Delete" || key === "Backspace") {
      const named = this.#focused(event);
      if (!state.selection.length && named) this.actions.choose(named, false);
      if (this.store.state.selection.length) this.actions.remove();
    } else if (key === "Enter") {
      if (!inStage) return false;
      this.#enter(event);
    } else if (key === " ") {
      if (event.repeat) return true;
      this.pointer.spaceHeld = true;
      this.pointer.spaceUsed = false;
      this.stage.dataset.space = "";
    } else {
      return this.singleKeys() && this.#single(key, event.repeat);
    }
    return true;
  }

  /**
   * @param {string} key
   * @param {boolean} repeat
   */
  #single(key, repeat) {
    const { does, actions, view } = this;
    const { selection, tool, removes } = this.store.state;
    const selected = selection.length > 0;
    /** @type {Record<string, () => unknown>} */
    const acts = {
      1: () => does.tool("point"),
      2: () => does.tool("line"),
      3: () => does.tool("path"),
      4: () => does.tool("lasso"),
      5: () => does.tool("brush"),
      x: () => isRegionTool(tool) && does.removes(!removes),
      m: () => does.arm(),
      r: () => selected && actions.putBack(),
      ".": () => selected && actions.bring(true),
      ",": () => selected && actions.bring(false),
      "[": () => (tool === "brush" ? actions.resizeBrush(-1) : actions.rotate(-TURN)),
      "]": () => (tool === "brush" ? actions.resizeBrush(1) : actions.rotate(TURN)),
      e: () => does.export(),
      p: () => does.play(),
      g: () => does.mesh(),
      c: () => does.compare(),
      b: () => repeat || this.store.do("show", { what: { peek: true } }),
      "+": () => view.zoomTo(view.zoom * 1.25),
      "=": () => view.zoomTo(view.zoom * 1.25),
      "-": () => view.zoomTo(view.zoom / 1.25),
      f: () => view.fit(),
      0: () => does.full(),
    };
    if (!acts[key]) return false;
    acts[key]();
    return true;
  }

  /** @param {Pick<KeyboardEvent, "key" | "target" | "shiftKey">} event */
  #up(event) {
    if (event.key === " ") {
      // Space without a pan selects the focused handle.
      const named =
        this.pointer.spaceHeld && !this.pointer.spaceUsed && event.target && this.#focused(event);
      if (named) this.actions.choose(named, event.shiftKey);
      this.pointer.spaceHeld = false;
      delete this.stage.dataset.space;
    }
    if (event.key.toLowerCase() === "b" && this.store.state.peek)
      this.store.do("show", { what: { peek: false } });
  }

  /** Releases held keys: no keyup arrives after the window loses the focus. */
  #release() {
    this.#up({ key: " ", target: null, shiftKey: false });
    this.#up({ key: "b", target: null, shiftKey: false });
  }
}
