// The pictures of the undo history. A picture that was replaced or closed stays, with its handles,
// its own undo steps and its file. The start page is `{ picture: null }`.

/** Pictures besides the open one; each of them keeps its file in memory. */
const MOST = 3;

/** @type {(earlier: Page.Kept[], left: Page.Kept) => Page.Kept[]} */
const withLast = (earlier, left) => (left.picture ? [...earlier, left].slice(-MOST) : earlier);

/**
 * The history after `left` was replaced by another picture, or closed: a new step, after which
 * nothing can be redone.
 * @type {(history: Page.History, left: Page.Kept) => Page.History}
 */
export const replaced = ({ earlier }, left) => ({
  earlier: withLast(earlier, left.picture ? { ...left, future: [] } : left),
  later: [],
});

/**
 * The history after undo (`back`) or redo went from `left` to the next picture.
 * @type {(history: Page.History, left: Page.Kept, back: boolean) => Page.History}
 */
export const stepped = ({ earlier, later }, left, back) =>
  back
    ? { earlier: earlier.slice(0, -1), later: [left, ...later] }
    : { earlier: withLast(earlier, left), later: later.slice(1) };

/**
 * The history without a picture that cannot be shown any more.
 * @param {Page.History} history
 * @param {Page.Kept} gone
 * @returns {Page.History}
 */
export function without({ earlier, later }, gone) {
  /** @type {(picture: Page.Kept) => boolean} */
  const stays = (picture) => picture !== gone;
  return { earlier: earlier.filter(stays), later: later.filter(stays) };
}

/**
 * The keys of the stored files that the history needs.
 * @type {(history: Page.History) => IDBValidKey[]}
 */
export const filesOf = ({ earlier, later }) =>
  [...earlier, ...later]
    .flatMap((p) => [p.file, p.annotations?.key])
    .filter((key) => key !== null && key !== undefined);
