// Alignment: the posed handles of another picture are brought to the frame of this one by the best
// map of a class, which the server reports. A document has the aligned handles in `handles` and, in
// `align`, the class and the handles as they were: { by, handles }. An edit of a handle makes the
// aligned pose the pose: then `align` is gone.

import * as api from "./api.js";
import { wire } from "./edits.js";
import { atStrength, keepPosed } from "./strength.js";

/** @type {Page.AlignClass[]} */
export const CLASSES = ["none", "rigid", "similarity", "affine"];

/** @type {(document: Pick<Page.Document, "align">) => Page.AlignClass} */
export const alignOf = ({ align }) => align?.by ?? "none";

/**
 * The document as it was before it was aligned.
 * @type {(document: Page.Document) => Page.Document}
 */
export const unaligned = ({ align, ...document }) =>
  align ? { ...document, handles: align.handles } : document;

/** @type {(x: number) => number} */
const round = (x) => Math.round(x * 100) / 100 + 0;

/**
 * @param {number[][]} map
 * @returns {(handle: Page.Handle) => Page.Handle}
 */
function handleBy([[a, b, c], [d, e, f]]) {
  /** @type {(place: Page.Place) => Page.Place} */
  const move = ([x, y]) => [round(a * x + b * y + c), round(d * x + e * y + f)];
  return ({ twist, ...handle }) => {
    const moved = { ...handle, q: handle.q.map(move) };
    if (!twist) return moved;
    const angle = (twist.angle * Math.PI) / 180;
    const [dx, dy] = [
      a * Math.cos(angle) + b * Math.sin(angle),
      d * Math.cos(angle) + e * Math.sin(angle),
    ];
    const turned = Math.round((Math.atan2(dy, dx) * 1800) / Math.PI) / 10 + 0;
    return {
      ...moved,
      twist: { ...twist, angle: turned, scale: Math.max(0.01, twist.scale * Math.hypot(dx, dy)) },
    };
  };
}

/**
 * The document with its handles aligned by a class, in a picture of this size. Throws a Problem.
 * @param {Page.Document} document
 * @param {Page.AlignClass} by
 * @param {{ width: number, height: number }} picture
 * @returns {Promise<Page.Document>}
 */
export async function aligned(document, by, { width, height }) {
  const plain = unaligned(atStrength(document, 1));
  if (by === "none" || !plain.handles.length) return plain;
  const { handles } = plain;
  const weights = handles.some((h) => h.weight !== undefined)
    ? { weights: handles.map((h) => h.weight ?? 1) }
    : {};
  // Only the map is wanted: a small grid is enough.
  const asked = {
    p: wire(plain, "p"),
    q: wire(plain, "q"),
    ...weights,
    align: by,
    grid: { columns: 2, rows: 2 },
  };
  const { matrix } = await api.alignment(asked, [width, height]);
  return { ...plain, handles: keepPosed(handles.map(handleBy(matrix))), align: { by, handles } };
}
