// What is in front in the live preview. The server draws whole cells by the weights of its map; the
// preview compares pixels, by weights in the plane.

import { alphaOf, depthOf, hasFocus } from "./edits.js";

/** Depths take this part of the range that is drawn. */
const SHARE = 0.9;

/**
 * The squared distance of a position from a handle at rest, px.
 * @param {Page.Place[]} places
 * @param {number} x
 * @param {number} y
 */
function awayFrom(places, x, y) {
  let least = (places[0][0] - x) ** 2 + (places[0][1] - y) ** 2;
  for (let k = 1; k < places.length; k++) {
    const [[ax, ay], [bx, by]] = [places[k - 1], places[k]];
    const [dx, dy] = [bx - ax, by - ay];
    const along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy);
    const t = Math.min(1, Math.max(0, along));
    least = Math.min(least, (ax + t * dx - x) ** 2 + (ay + t * dy - y) ** 2);
  }
  return least;
}

/**
 * How far in front each vertex of a grid is, from -1 to 1; null if all handles have one depth.
 * @param {Page.Document} document
 * @param {Page.Mesh} mesh
 * @returns {Float32Array | null}
 */
export function depthsOf(document, mesh) {
  const { handles } = document;
  const depths = handles.map(depthOf);
  const [least, most] = [Math.min(...depths), Math.max(...depths)];
  if (!(least < most)) return null;
  const { columns, rows } = mesh.grid;
  const alpha = hasFocus(document) ? alphaOf(document) : 1;
  const carried = new Float32Array(columns * rows);
  for (let j = 0, at = 0; j < rows; j++)
    for (let i = 0; i < columns; i++, at++) {
      const [x, y] = [mesh.restX(i), mesh.restY(j)];
      let [sum, total] = [0, 0];
      handles.forEach(({ p }, k) => {
        // A position on a handle has its depth.
        const weight = Math.max(1e-6, awayFrom(p, x, y)) ** -alpha;
        sum += weight * (depths[k] - least);
        total += weight;
      });
      carried[at] = SHARE * ((2 * sum) / total / (most - least) - 1);
    }
  return carried;
}
