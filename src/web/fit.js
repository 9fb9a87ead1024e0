// "Choose for me": the server leaves out each pin and predicts it from the others; the method that
// predicts best is chosen. The residuals are shown as arrows until a handle or the method changes.

import * as api from "./api.js";
import { known } from "./dom.js";
import { wire } from "./edits.js";
import { fitWords } from "./words.js";

/** Fewer pins say nothing about a method. */
export const LEAST_PINS = 4;
/** Arrows are magnified by one of these, so that the longest has about this length, CSS px. */
const SCALES = [1, 2, 5, 10, 20, 50, 100];
const LONGEST = 160;
const PARAMETERS = /** @type {const} */ (["method", "alpha", "smoothing"]);

/** @type {(best: Page.FitBest) => (candidate: Page.FitCandidate) => boolean} */
const of = (best) => (candidate) => PARAMETERS.every((name) => candidate[name] === best[name]);

/**
 * How often arrows are magnified.
 * @param {Page.Place[]} residuals
 * @param {number} zoom
 */
function scaleOf(residuals, zoom) {
  const longest = Math.max(...residuals.map(([x, y]) => Math.hypot(x, y))) * zoom;
  return known(SCALES.findLast((scale) => scale === 1 || scale * longest <= LONGEST));
}

/**
 * Compares the methods, and sets the best. Throws a Problem.
 * @param {Page.Store} store
 * @param {Page.Sync} sync
 * @param {Page.View} view
 * @param {Page.UserActions} actions
 */
export async function chooseMethod(store, sync, view, actions) {
  const { document: asked } = store.state;
  await sync.settled();
  if (store.state.document !== asked || !sync.session) return;
  const { best, candidates } = await api.fit(sync.session.id, { q: wire(asked, "q") });
  // Changed in the meantime: the choice is of other handles.
  if (store.state.document !== asked) return;
  const { residuals, outliers } = known(candidates.find(of(best)));
  const scale = scaleOf(residuals, view.zoom);
  const words = fitWords({ best, candidates, before: asked.method, outliers, scale });
  const { smoothing: _, ...others } = asked;
  const chosen = {
    ...others,
    method: best.method,
    alpha: best.alpha ?? null,
    ...(best.smoothing && { smoothing: best.smoothing }),
  };
  const isSame = PARAMETERS.every((name) => chosen[name] === asked[name]);
  if (!isSame) actions.edit(chosen);
  store.do("fit", { fit: { residuals, outliers, scale, words } });
  actions.say(words);
}
