// The strength of the pose: 0 is the rest pose, 1 the full one, and values beyond exaggerate it. A
// document at another strength than 1 shows the pose of that strength in `handles` and has the full
// one in `full`. An edit of a handle makes the shown pose the full one.

/**
 * Handles that the page has posed by itself: not edited.
 * @type {WeakSet<Page.Handle[]>}
 */
const posed = new WeakSet();
/** @type {(handles: Page.Handle[]) => Page.Handle[]} */
export const keepPosed = (handles) => (posed.add(handles), handles);

/** @type {(document: Pick<Page.Document, "strength">) => number} */
export const strengthOf = (document) => document.strength ?? 1;

/**
 * @param {Page.Document} document
 * @returns {Page.Document}
 */
function without({ strength: _, full: __, ...document }) {
  return document;
}

/**
 * The strength that is shown: that of the document, or of the frame of a playing animation.
 * @type {(state: Pick<Page.State, "playing" | "document">) => number}
 */
export const shownStrength = ({ playing, document }) =>
  typeof playing === "number" ? playing : strengthOf(document);

/**
 * The poses from rest to the shown pose, or to the full one if rest is shown: a function of t from
 * 0 to 1, and `goal`, the strength at the end.
 * @param {Page.Document} document
 * @returns {{ goal: number, at: (t: number) => Page.Document }}
 */
export function posesOf(document) {
  const goal = strengthOf(document) || 1;
  const shown = atStrength(document, goal);
  const whole = { ...without(shown), handles: shown.handles };
  return { goal, at: (t) => atStrength(whole, t) };
}

/** @type {(x: number) => number} */
const round = (x) => Math.round(x * 100) / 100 + 0;

/** @type {(twist: Page.Twist, t: number) => Page.Twist} */
const atTwist = (twist, t) => ({
  ...twist,
  angle: Math.round(10 * t * twist.angle) / 10 + 0,
  scale: Math.max(0.01, 1 + t * (twist.scale - 1)),
});

/**
 * @param {Page.Document} document
 * @param {number} t
 * @returns {Page.Document}
 */
export function atStrength(document, t) {
  if (t === strengthOf(document)) return document;
  const full = document.full ?? document.handles;
  if (t === 1) {
    posed.add(full);
    return { ...without(document), handles: full };
  }
  const handles = full.map(({ q, twist, ...handle }) => ({
    ...handle,
    q: q.map((place, k) =>
      place.map((c, axis) => round(handle.p[k][axis] + t * (c - handle.p[k][axis]))),
    ),
    ...(twist && { twist: atTwist(twist, t) }),
  }));
  posed.add(handles);
  return { ...document, handles, full, strength: t };
}

/**
 * The document after an edit: if its handles were edited, the shown pose is the full one, and the
 * aligned pose the pose.
 * @param {Page.Document} document
 * @param {Page.Document} before
 * @returns {Page.Document}
 */
export function settled(document, before) {
  if (document.handles === before.handles || posed.has(document.handles)) return document;
  const { align: _, ...edited } = without(document);
  return edited;
}
