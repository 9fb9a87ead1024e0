// Notices beside the stage that offer a change: which landmark file is rest and which pose, the old
// place of what has moved, unused files.

import { alignOf } from "./align.js";
import { holesOf } from "./edits.js";
import { isRegionTool, regionOf } from "./region.js";
import { unusedWords } from "./words.js";

const find = (id) => document.getElementById(id);
const text = (id, words) => find(id).textContent !== words && (find(id).textContent = words);

const isPosed = ({ p, q, twist }) =>
  Boolean(twist) || p.some((place, k) => place[0] !== q[k][0] || place[1] !== q[k][1]);

export class Notices {
  constructor(store, actions) {
    const click = (id, act) => find(id).addEventListener("click", act);
    const show = (what) => store.do("show", { what });
    click("sides-swap", () => actions.swap());
    click("sides-align", () => actions.align("similarity"));
    click("sides-close", () => show({ sidesClosed: true }));
    click("holes-clear", () => actions.edit({ ...store.state.document, holes: "transparent" }));
    click("holes-close", () => show({ holesClosed: true }));
    click("unused-close", () => store.do("unused", { names: [] }));
    store.subscribe((state) => this.#draw(state));
  }

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
