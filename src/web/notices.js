// Notices beside the stage that offer a change: which landmark file is rest and which pose, the old
// place of what has moved, unused files.

import { alignOf } from "./align.js";
import { find, text } from "./dom.js";
import { holesOf } from "./edits.js";
import { isRegionTool, regionOf } from "./region.js";
import { unusedWords } from "./words.js";

/** @type {(handle: Page.Handle) => boolean} */
const isPosed = ({ p, q, twist }) =>
  Boolean(twist) || p.some((place, k) => place[0] !== q[k][0] || place[1] !== q[k][1]);

export class Notices {
  /**
   * @param {Page.Store} store
   * @param {Page.UserActions} actions
   */
  constructor(store, actions) {
    /** @type {(id: keyof PageElements, act: () => unknown) => void} */
    const click = (id, act) => find(id).addEventListener("click", act);
    /** @type {(what: Partial<Page.State>) => void} */
    const show = (what) => store.do("show", { what });
    click("sides-swap", () => actions.swap());
    click("sides-align", () => actions.align("similarity"));
    click("sides-close", () => show({ sidesClosed: true }));
    click("holes-clear", () => actions.edit({ ...store.state.document, holes: "transparent" }));
    click("holes-close", () => show({ holesClosed: true }));
    click("unused-close", () => store.do("unused", { names: [] }));
    store.subscribe((state) => this.#draw(state));
  }

  /** @param {Page.State} state */
  #draw({
    phase,
    document,
    before,
    compare,
    playing,
    tool,
    draft,
    unused,
    sidesClosed,
    holesClosed,
  }) {
    const quiet =
      phase !== "open" || compare || playing !== null || isRegionTool(tool) || draft.length > 0;
    const { sides, handles } = document;
    find("sides").hidden = quiet || sidesClosed || !sides || !handles.length;
    if (sides) {
      text("sides-rest", sides[0]);
      text("sides-pose", sides[1]);
      find("sides-align").hidden = alignOf(document) !== "none";
    }
    // Not in a drag: it would appear under the pointer.
    const isDrawnTwice =
      regionOf(document).parts.length > 0 && holesOf(document) === "keep" && handles.some(isPosed);
    if (!before) find("holes-hint").hidden = quiet || holesClosed || !isDrawnTwice;
    find("unused").hidden = quiet || !unused.length;
    if (unused.length) text("unused-text", unusedWords(unused));
  }
}
