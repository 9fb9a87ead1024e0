// The front of mlswarp.widget: a module of anywidget (https://anywidget.dev/en/afm) that shows the
// handles of a model in <mls-warp>, and tells the model of drags.

import { MlsWarp } from "../../../src/web/element/element.js";
import { fits } from "../../../src/web/element/wire.js";

/**
 * @typedef {{
 *   get(name: string): any,
 *   set(name: string, value: unknown): void,
 *   on(event: string, act: () => void): void,
 *   off(event: string, act: () => void): void,
 *   save_changes(): void,
 * }} Model
 */

/** What both sides change. */
const SHARED = /** @type {const} */ (["p", "q", "method", "strength", "tool"]);

/** @param {{ model: Model, el: HTMLElement }} place */
function render({ model, el }) {
  // Each widget may load this module again.
  if (!customElements.get("mls-warp")) customElements.define("mls-warp", MlsWarp);
  const warp = /** @type {MlsWarp} */ (document.createElement("mls-warp"));
  const trouble = document.createElement("p");
  trouble.setAttribute("role", "alert");
  trouble.hidden = true;

  const shown = () => Object.fromEntries(SHARED.map((name) => [name, warp[name]]));
  function show() {
    const [p, q, method, strength] = SHARED.map((name) => model.get(name));
    // Those at rest may arrive first.
    const wanted = { p, q: fits(p, q) ? q : p, method, strength };
    const { tool: _, ...now } = shown();
    // What the element shows already would end a drag.
    if (JSON.stringify(wanted) !== JSON.stringify(now)) warp.warp = { ...warp.warp, ...wanted };
  }
  let isDue = false;
  function follow() {
    if (isDue) return;
    isDue = true;
    // After all that changes together.
    queueMicrotask(() => {
      isDue = false;
      try {
        show();
      } catch (error) {
        tell(error);
      }
    });
  }

  let frame = 0;
  function send() {
    cancelAnimationFrame(frame);
    frame = 0;
    trouble.hidden = true;
    const changed = Object.entries(shown()).filter(
      ([name, value]) => JSON.stringify(value) !== JSON.stringify(model.get(name)),
    );
    for (const [name, value] of changed) model.set(name, value);
    if (changed.length) model.save_changes();
  }
  /** @param {unknown} error */
  function tell(error) {
    trouble.hidden = false;
    trouble.textContent = error instanceof Error ? error.message : String(error);
  }

  const resize = () => (warp.style.height = `${model.get("height")}px`);
  const pick = () => (warp.tool = model.get("tool"));
  const acts = Object.entries({
    p: follow,
    q: follow,
    method: follow,
    strength: follow,
    tool: pick,
    height: resize,
  });
  Object.assign(warp.style, { width: "fit-content", maxWidth: "100%" });
  warp.setAttribute("aria-label", "Picture with handles");
  warp.addEventListener("warpinput", () => (frame ||= requestAnimationFrame(send)));
  warp.addEventListener("warpchange", send);
  warp.addEventListener("warperror", (event) => tell(/** @type {CustomEvent} */ (event).detail));
  for (const [name, act] of acts) {
    act();
    model.on(`change:${name}`, act);
  }
  warp.image = new Blob([model.get("image_bytes")]);
  el.append(warp, trouble);
  return () => {
    cancelAnimationFrame(frame);
    for (const [name, act] of acts) model.off(`change:${name}`, act);
    warp.remove();
    trouble.remove();
  };
}

export default { render };
