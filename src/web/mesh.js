// The posed grid from the server: the forward map, the inverse map, and the folded cells. Rest
// lines are at 0, c, 2c, ...; the last one is at the edge of the picture. Each cell is a bilinear
// patch; where cells overlap, the later one in row order is visible.

export class Mesh {
  /**
   * `grid`: columns, rows, width, height, cell [w, h]; `places`: x, y of each vertex, row by row,
   * picture px.
   * @param {Page.MeshGrid} grid
   * @param {Float32Array} places
   */
  constructor(grid, places) {
    this.grid = grid;
    this.places = places;
    /**
     * How far in front each vertex is (depth.js); null: cells are drawn in row order.
     * @type {Float32Array | null}
     */
    this.depths = null;
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  static identity(width, height) {
    return new Mesh(
      { columns: 2, rows: 2, width, height, cell: [width, height] },
      new Float32Array([0, 0, width, 0, 0, height, width, height]),
    );
  }

  /**
   * The undeformed grid.
   * @param {Page.MeshGrid} grid
   */
  static atRest(grid) {
    const mesh = new Mesh(grid, new Float32Array(2 * grid.columns * grid.rows));
    for (let j = 0, k = 0; j < grid.rows; j++)
      for (let i = 0; i < grid.columns; i++, k += 2)
        mesh.places.set([mesh.restX(i), mesh.restY(j)], k);
    return mesh;
  }

  /**
   * A compact frame of the drag socket: `seq`, the scale of the displacements, and those of each
   * vertex as 16-bit integers.
   * @param {Page.MeshGrid} grid
   * @param {ArrayBuffer} frame
   */
  static ofCompact(grid, frame) {
    const data = new DataView(frame);
    const scale = data.getFloat32(8, true);
    const { places } = Mesh.atRest(grid);
    return new Mesh(
      grid,
      places.map((at, k) => at + scale * data.getInt16(12 + 2 * k, true)),
    );
  }

  /**
   * The mesh between this one (share 0) and another one of the same grid (share 1).
   * @param {Mesh} other
   * @param {number} share
   */
  towards(other, share) {
    const between = new Mesh(
      this.grid,
      this.places.map((c, k) => c + share * (other.places[k] - c)),
    );
    between.depths = this.depths;
    return between;
  }

  /** @param {number} i */
  restX(i) {
    return i === this.grid.columns - 1 ? this.grid.width : i * this.grid.cell[0];
  }

  /** @param {number} j */
  restY(j) {
    return j === this.grid.rows - 1 ? this.grid.height : j * this.grid.cell[1];
  }

  /**
   * @param {number} i
   * @param {number} j
   * @returns {Page.Place}
   */
  posed(i, j) {
    const k = 2 * (j * this.grid.columns + i);
    return [this.places[k], this.places[k + 1]];
  }

  /**
   * @param {number} i
   * @param {number} j
   */
  corners(i, j) {
    return [this.posed(i, j), this.posed(i + 1, j), this.posed(i + 1, j + 1), this.posed(i, j + 1)];
  }

  /**
   * The posed position of a rest position, or null outside of the picture.
   * @param {number} x
   * @param {number} y
   * @returns {Page.Place | null}
   */
  forward(x, y) {
    const { columns, rows, cell, width, height } = this.grid;
    if (!(x >= 0 && y >= 0 && x <= width && y <= height)) return null;
    const [i, j] = [
      Math.min(columns - 2, Math.floor(x / cell[0])),
      Math.min(rows - 2, Math.floor(y / cell[1])),
    ];
    const [s, t] = [
      (x - this.restX(i)) / (this.restX(i + 1) - this.restX(i)),
      (y - this.restY(j)) / (this.restY(j + 1) - this.restY(j)),
    ];
    const [a, b, c, d] = this.corners(i, j);
    return a.map((_, k) => (1 - t) * ((1 - s) * a[k] + s * b[k]) + t * ((1 - s) * d[k] + s * c[k]));
  }

  /**
   * The source position of (x, y). Outside the posed picture, uses the displacement of the nearest
   * vertex.
   * @param {number} x
   * @param {number} y
   * @returns {Page.Place}
   */
  inverse(x, y) {
    const { columns, rows } = this.grid;
    for (let j = rows - 2; j >= 0; j--) {
      for (let i = columns - 2; i >= 0; i--) {
        const at = this.#inCell(i, j, x, y);
        if (at) {
          const [left, top] = [this.restX(i), this.restY(j)];
          return [
            left + at[0] * (this.restX(i + 1) - left),
            top + at[1] * (this.restY(j + 1) - top),
          ];
        }
      }
    }
    return this.#carried(x, y);
  }

  /**
   * The cell coordinates (s, t in [0, 1]) of a position, or null.
   * @param {number} i
   * @param {number} j
   * @param {number} x
   * @param {number} y
   * @returns {Page.Place | null}
   */
  #inCell(i, j, x, y) {
    const { columns } = this.grid;
    const m = this.places;
    const a = 2 * (j * columns + i);
    const d = a + 2 * columns;
    const [ax, ay, bx, by] = [m[a], m[a + 1], m[a + 2], m[a + 3]];
    const [dx, dy, cx, cy] = [m[d], m[d + 1], m[d + 2], m[d + 3]];
    if (
      x < Math.min(ax, bx, cx, dx) ||
      x > Math.max(ax, bx, cx, dx) ||
      y < Math.min(ay, by, cy, dy) ||
      y > Math.max(ay, by, cy, dy)
    )
      return null;
    let [s, t] = [0.5, 0.5];
    for (let step = 0; step < 12; step++) {
      const fx = (1 - t) * ((1 - s) * ax + s * bx) + t * ((1 - s) * dx + s * cx) - x;
      const fy = (1 - t) * ((1 - s) * ay + s * by) + t * ((1 - s) * dy + s * cy) - y;
      const [sx, sy] = [(1 - t) * (bx - ax) + t * (cx - dx), (1 - t) * (by - ay) + t * (cy - dy)];
      const [tx, ty] = [(1 - s) * (dx - ax) + s * (cx - bx), (1 - s) * (dy - ay) + s * (cy - by)];
      const area = sx * ty - sy * tx;
      if (area === 0) return null;
      const [ds, dt] = [(fy * tx - fx * ty) / area, (fx * sy - fy * sx) / area];
      [s, t] = [s + ds, t + dt];
      if (Math.abs(ds) + Math.abs(dt) < 1e-9) break;
    }
    const near = 1e-6;
    if (!(s >= -near && s <= 1 + near && t >= -near && t <= 1 + near)) return null;
    return [Math.min(1, Math.max(0, s)), Math.min(1, Math.max(0, t))];
  }

  /**
   * @param {number} x
   * @param {number} y
   * @returns {Page.Place}
   */
  #carried(x, y) {
    let [best, least] = [0, Infinity];
    for (let k = 0; k < this.places.length; k += 2) {
      const away = (this.places[k] - x) ** 2 + (this.places[k + 1] - y) ** 2;
      if (away < least) [best, least] = [k, away];
    }
    const vertex = best / 2;
    const [i, j] = [vertex % this.grid.columns, Math.floor(vertex / this.grid.columns)];
    return [this.restX(i) + x - this.places[best], this.restY(j) + y - this.places[best + 1]];
  }

  /**
   * Folded cells as [i, j]: their orientation is not that of most of the area at rest, or the cross
   * products at their corners have several signs. The server uses the same rule: a mirror image has
   * no folds.
   * @returns {Page.Place[]}
   */
  folded() {
    const { columns, rows } = this.grid;
    const m = this.places;
    const [signs, areas] = [new Int8Array((columns - 1) * (rows - 1)), [0, 0, 0]];
    for (let j = 0, k = 0; j < rows - 1; j++) {
      for (let i = 0; i < columns - 1; i++, k++) {
        const a = 2 * (j * columns + i);
        const d = a + 2 * columns;
        const [topX, topY] = [m[a + 2] - m[a], m[a + 3] - m[a + 1]];
        const [bottomX, bottomY] = [m[d + 2] - m[d], m[d + 3] - m[d + 1]];
        const [leftX, leftY] = [m[d] - m[a], m[d + 1] - m[a + 1]];
        const [rightX, rightY] = [m[d + 2] - m[a + 2], m[d + 3] - m[a + 3]];
        const [p, q] = [topX * leftY - topY * leftX, topX * rightY - topY * rightX];
        const [r, s] = [bottomX * rightY - bottomY * rightX, bottomX * leftY - bottomY * leftX];
        signs[k] = p > 0 && q > 0 && r > 0 && s > 0 ? 1 : p < 0 && q < 0 && r < 0 && s < 0 ? -1 : 0;
        areas[1 + signs[k]] +=
          (this.restX(i + 1) - this.restX(i)) * (this.restY(j + 1) - this.restY(j));
      }
    }
    const whole = areas[0] > areas[2] ? -1 : 1;
    /** @type {Page.Place[]} */
    const cells = [];
    signs.forEach(
      (sign, k) => sign === whole || cells.push([k % (columns - 1), Math.floor(k / (columns - 1))]),
    );
    return cells;
  }

  /**
   * Divides every cell into n x n: posed positions of (n (columns - 1) + 1) x (n (rows - 1) + 1)
   * vertices.
   * @param {number} n
   */
  refined(n) {
    if (n === 1) return this.places;
    const { columns, rows } = this.grid;
    const [wide, high] = [n * (columns - 1) + 1, n * (rows - 1) + 1];
    const fine = new Float32Array(2 * wide * high);
    for (let y = 0; y < high; y++) {
      const j = Math.min(Math.floor(y / n), rows - 2);
      const t = (y - j * n) / n;
      for (let x = 0; x < wide; x++) {
        const i = Math.min(Math.floor(x / n), columns - 2);
        const s = (x - i * n) / n;
        const a = 2 * (j * columns + i);
        const d = a + 2 * columns;
        const at = 2 * (y * wide + x);
        for (let axis = 0; axis < 2; axis++) {
          const top = this.places[a + axis] * (1 - s) + this.places[a + 2 + axis] * s;
          const bottom = this.places[d + axis] * (1 - s) + this.places[d + 2 + axis] * s;
          fine[at + axis] = top * (1 - t) + bottom * t;
        }
      }
    }
    return fine;
  }

  /**
   * Rest x or y of the lines of `refined(n)`.
   * @param {number} n
   * @param {0 | 1} along
   */
  refinedLines(n, along) {
    /** @type {[number, (k: number) => number]} */
    const [count, rest] =
      along === 0
        ? [this.grid.columns, (k) => this.restX(k)]
        : [this.grid.rows, (k) => this.restY(k)];
    return Float32Array.from({ length: n * (count - 1) + 1 }, (_, k) => {
      const cell = Math.min(Math.floor(k / n), count - 2);
      const share = (k - cell * n) / n;
      return rest(cell) * (1 - share) + rest(cell + 1) * share;
    });
  }
}
