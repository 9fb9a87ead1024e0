// The pictures of the undo history. A picture that was replaced or closed stays, with its handles,
// its own undo steps and its file. The start page is `{ picture: null }`.

/** Pictures besides the open one; each of them keeps its file in memory. */
const MOST = 3;

const withLast = (earlier, left) => (left.picture ? [...earlier, left].slice(-MOST) : earlier);

/**
 * The history after `left` was replaced by another picture, or closed: a new step, after which
 * nothing can be redone.
 */
export const replaced = ({ earlier }, left) => ({
  earlier: withLast(earlier, { ...left, future: [] }),
  later: [],
});

/** The history after undo (`back`) or redo went from `left` to the next picture. */
export const stepped = ({ earlier, later }, left, back) =>
  back
    ? { earlier: earlier.slice(0, -1), later: [left, ...later] }
    : { earlier: withLast(earlier, left), later: later.slice(1) };

/** The history without a picture that cannot be shown any more. */
export function without({ earlier, later }, gone) {
  const stays = (picture) => picture !== gone;
  return { earlier: earlier.filter(stays), later: later.filter(stays) };
}

/** The keys of the stored files that the history needs. */
export const filesOf = ({ earlier, later }) =>
  [...earlier, ...later].map((p) => p.file).filter((key) => key !== null && key !== undefined);
