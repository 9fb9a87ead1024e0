// The live preview of `outside: edge`: every pixel outside the posed picture has the colour of the
// nearest border position. Each border segment has a strip on both sides, and each vertex has fans
// between the strips. The depth is the distance from the border, so the nearest one is visible. The
// picture is drawn over them.

/** Numbers per vertex: x, y (picture px), depth, and the texture coordinates. */
export const STRIDE = 5;
/** Triangles per fan: the chord of a wide triangle would be too close to the border. */
const FAN = 4;

/**
 * A place on the posed border, and its place in the texture.
 *
 * @typedef {[place: Page.Place, u: number, v: number]} Vertex
 */

/**
 * The border vertices of the grid, as a closed path.
 * @param {Page.MeshGrid} grid
 * @returns {Page.Place[]}
 */
function around({ columns, rows }) {
  const [right, bottom] = [columns - 1, rows - 1];
  /** @type {(count: number, place: (k: number) => Page.Place) => Page.Place[]} */
  const along = (count, place) => Array.from({ length: count }, (_, k) => place(k));
  return [
    ...along(right, (i) => [i, 0]),
    ...along(bottom, (j) => [right, j]),
    ...along(right, (i) => [right - i, bottom]),
    ...along(bottom + 1, (j) => [0, bottom - j]),
  ];
}

/**
 * Triangles around the posed border, three vertices each.
 * @param {Page.Mesh} mesh
 */
export function edgeTriangles(mesh) {
  const { width, height } = mesh.grid;
  /** @type {Vertex[]} */
  const border = around(mesh.grid).map(([i, j]) => [
    mesh.posed(i, j),
    mesh.restX(i) / width,
    mesh.restY(j) / height,
  ]);
  // The largest visible distance from the border.
  const reach =
    4 * Math.max(width, height, ...border.map(([[x, y]]) => Math.max(Math.abs(x), Math.abs(y))));
  /** @type {number[]} */
  const numbers = [];
  /**
   * `angle` null: a position on the border.
   * @type {(vertex: Vertex, angle: number | null) => void}
   */
  const vertex = ([[x, y], u, v], angle) => {
    if (angle === null) numbers.push(x, y, 0, u, v);
    else numbers.push(x + reach * Math.cos(angle), y + reach * Math.sin(angle), 1, u, v);
  };
  /** @type {(...corners: [Vertex, number | null][]) => void} */
  const triangle = (...corners) => corners.forEach(([place, angle]) => vertex(place, angle));
  /** @type {number | null} */
  let before = null;
  /** @type {[Vertex, number, number][]} */
  const turns = [];
  border.slice(1).forEach((b, k) => {
    const a = border[k];
    const [dx, dy] = [b[0][0] - a[0][0], b[0][1] - a[0][1]];
    if (dx === 0 && dy === 0) return;
    const normal = Math.atan2(-dx, dy);
    for (const side of [normal, normal + Math.PI]) {
      triangle([a, null], [b, null], [b, side]);
      triangle([a, null], [b, side], [a, side]);
    }
    if (before !== null) turns.push([a, before, normal]);
    before = normal;
  });
  // The path is closed: the last segment meets the first.
  if (turns.length)
    turns.push([
      border[0],
      /** @type {number} a turn has two */ (/** @type {unknown} */ (before)),
      turns[0][1],
    ]);
  for (const [place, from, to] of turns) {
    const turn = Math.atan2(Math.sin(to - from), Math.cos(to - from)) / FAN;
    for (const side of [from, from + Math.PI]) {
      for (let k = 0; k < FAN; k++)
        triangle([place, null], [place, side + k * turn], [place, side + (k + 1) * turn]);
    }
  }
  return new Float32Array(numbers);
}
