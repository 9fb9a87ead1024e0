// What is in front in the live preview. The server draws whole cells by the weights of its map; the
// preview compares pixels, by weights in the plane.

import { alphaOf, depthOf, hasFocus } from "./edits.js";

/** Depths take this part of the range that is drawn. */
const SHARE = 0.9;

/**
 * The squared distance of a position from a handle at rest, px; `numbers`: x, y of its places.
 * @param {Float64Array} numbers
 * @param {number} x
 * @param {number} y
 */
function awayFrom(numbers, x, y) {
  const [ox, oy] = [numbers[0] - x, numbers[1] - y];
  let least = ox * ox + oy * oy;
  for (let k = 2; k < numbers.length; k += 2) {
    const [ax, ay] = [numbers[k - 2] - x, numbers[k - 1] - y];
    const [dx, dy] = [numbers[k] - x - ax, numbers[k + 1] - y - ay];
    const t = Math.min(1, Math.max(0, -(ax * dx + ay * dy) / (dx * dx + dy * dy)));
    const [ux, uy] = [ax + t * dx, ay + t * dy];
    least = Math.min(least, ux * ux + uy * uy);
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
  const places = handles.map(({ p }) => Float64Array.from(p.flat()));
  const carried = new Float32Array(columns * rows);
  for (let j = 0, at = 0; j < rows; j++)
    for (let i = 0; i < columns; i++, at++) {
      const [x, y] = [mesh.restX(i), mesh.restY(j)];
      let [sum, total] = [0, 0];
      // Without closures, and a power only where one is needed: a drag that begins waits for it.
      for (let k = 0; k < places.length; k++) {
        // A position on a handle has its depth.
        const away = Math.max(1e-6, awayFrom(places[k], x, y));
        const weight = alpha === 1 ? 1 / away : alpha === 2 ? 1 / (away * away) : away ** -alpha;
        sum += weight * (depths[k] - least);
        total += weight;
      }
      carried[at] = SHARE * ((2 * sum) / total / (most - least) - 1);
    }
  return carried;
}
