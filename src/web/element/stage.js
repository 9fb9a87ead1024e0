// The stage of the page in a shadow root: picture, handles, live preview, pointer, touch and keys.

import { Actions } from "../actions.js";
import { canvasOf } from "../canvas.js";
import { contextOf, inStage } from "../dom.js";
import { filterOf, outsideOf } from "../edits.js";
import { Handles } from "../handles.js";
import { Keys } from "../keys.js";
import { Loupe } from "../loupe.js";
import { Pointer } from "../pointer.js";
import { View } from "../view.js";

/**
 * An element with attributes. Markup in a string would need a Trusted Type on some sites.
 *
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {Record<string, string>} [attributes]
 * @param {...(Node | string)} children
 */
function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** The layers, as in index.html: what the page alone has is left out. */
function layers() {
  const quiet = { "aria-hidden": "true" };
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, value] of Object.entries({
    id: "handles",
    role: "group",
    "aria-label": "Handles",
  }))
    svg.setAttribute(key, value);
  return [
    element("div", { id: "board" }),
    element("img", { id: "picture", alt: "" }),
    element("canvas", { id: "live", ...quiet }),
    element("img", { id: "original", alt: "" }),
    element("canvas", { id: "region", hidden: "", ...quiet }),
    element("canvas", { id: "grid", ...quiet }),
    element("div", { id: "divider", hidden: "" }),
    element("canvas", { id: "marks", ...quiet }),
    element("canvas", { id: "moving", hidden: "", ...quiet }),
    svg,
    element("canvas", { id: "loupe", hidden: "", ...quiet }),
  ];
}

const HELP =
  "Arrow keys move the selected handles, or a cross if none is selected. Enter adds a handle at the cross.";

/** What is free around the picture, CSS px. */
const MARGINS = { wide: [12, 12], narrow: [8, 8], from: [480, 320] };

export class Stage {
  #end = new AbortController();

  /**
   * @param {ShadowRoot} root
   * @param {Page.Store} store
   * @param {() => import("./follower.js").Follower | null} warper
   */
  constructor(root, store, warper) {
    const stage = element("div", { id: "stage", part: "stage", tabindex: "0" }, ...layers());
    stage.setAttribute("aria-describedby", "stage-help");
    const says = element("p", { id: "says", class: "unseen", "aria-live": "polite" });
    root.replaceChildren(stage, element("p", { id: "stage-help", class: "unseen" }, HELP), says);
    this.stage = stage;
    this.view = new View(stage, true);
    this.view.margins = MARGINS;
    const { view } = this;
    const sync = {
      get mesh() {
        return warper()?.mesh ?? null;
      },
      aligned: async () => null,
    };
    this.handles = new Handles(inStage(stage, "handles"), store, view);
    const say = (/** @type {string} */ words) => (says.textContent = words);
    this.actions = new Actions(store, sync, view, this.handles, say, () => {});
    const loupe = new Loupe(inStage(stage, "loupe"), view, () => true);
    // The element has no tools for a region.
    const region = /** @type {import("../regiontool.js").RegionTool} */ (
      /** @type {unknown} */ ({ draw() {}, hover() {} })
    );
    this.pointer = new Pointer(stage, store, view, this.handles, this.actions, loupe, region);
    const does = doing(store, view);
    const { signal } = this.#end;
    new Keys(stage, store, view, this.handles, this.pointer, this.actions, does, () => true, {
      root,
      signal,
    });
    store.subscribe((state, previous) => !signal.aborted && this.#show(state, previous));
  }

  /**
   * @param {Page.State} state
   * @param {Page.State} previous
   */
  #show(state, previous) {
    const { meshShown: lines, compare, compareAt: at, peek, document } = state;
    const names = /** @type {const} */ (["meshShown", "compare", "compareAt", "peek"]);
    if (names.some((name) => state[name] !== previous[name]))
      this.view.show({ lines, compare, at, peek });
    this.view.setOutside(outsideOf(document));
    this.view.setFilter(filterOf(document));
    this.view.setCanvas(canvasOf(document));
    this.stage.classList.toggle("armed", Boolean(state.arm || state.draft.length));
  }

  release() {
    this.#end.abort();
    this.view.release();
  }
}

/**
 * What keys do. Those of the page's other controls do nothing here.
 *
 * @param {Page.Store} store
 * @param {Page.View} view
 * @returns {Page.Does}
 */
function doing(store, view) {
  const nothing = () => {};
  return {
    pick: nothing,
    pickHandles: nothing,
    close: nothing,
    export: nothing,
    help: nothing,
    key: nothing,
    play: nothing,
    removes: nothing,
    fit: async () => {},
    mending: () => null,
    alternative: () => null,
    mend: nothing,
    tool: (tool) => tool !== "lasso" && tool !== "brush" && store.do("tool", { tool }),
    mesh: () => store.do("show", { what: { meshShown: !store.state.meshShown } }),
    compare: () =>
      store.do("show", { what: { compare: !store.state.compare, arm: "", draft: [] } }),
    arm: () => store.do("arm", { arm: store.state.arm ? "" : "move" }),
    full: () => view.zoomTo(1 / view.scale),
  };
}

/**
 * What can be shown as a picture, as a file: PNG, unless it is one.
 *
 * @param {Blob | ImageBitmap | ImageData} image
 * @returns {Promise<Blob>}
 */
export async function fileOf(image) {
  if (image instanceof Blob) return image;
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: image.width, height: image.height });
  const context = contextOf(canvas);
  if (image instanceof ImageData) context.putImageData(image, 0, 0);
  else context.drawImage(image, 0, 0);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the picture is too large")))),
  );
}
