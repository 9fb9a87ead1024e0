// Poses without the server: the coefficients of a session (`GET /sessions/{id}/plan`; /docs
// describes the file), and when they are fetched.

import { Mesh } from "./mesh.js";

/** Vertices of the first lattice, about as many along a unit of both sides. */
const VERTICES = 2500;
/** A larger file is not requested, bytes. */
const LARGEST = 2e6;
/** The first file may be followed by a finer one if that takes at most this time, ms. */
const FINER = 400;
/** The server has no table of larger splines. */
const SPLINE = 64;
/**
 * Positions along a segment at which its residual is measured: `SEGMENT_SAMPLES` of
 * src/engine/warp/quality.rs.
 */
const SAMPLES = 5;

/** @type {(handle: Page.WireHandle) => handle is Page.Place[]} */
const isLine = (handle) => Array.isArray(handle[0]);

/** The layout of coefficients of segments. */
const LINES = 3;
/** Numbers of a vertex for a column; of other methods at most three. */
const PLANES = { similarity: 2, affine: 1, tps: 1, global_affine: 1 };

const HEADER = 64;
const MEMBER = 16;

/**
 * The value of a half-precision number.
 * @param {number} bits
 */
function half(bits) {
  const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
  const size = exponent ? (1024 + fraction) * 2 ** (exponent - 25) : fraction * 2 ** -24;
  return bits >> 15 ? -size : size;
}

/** A file of coefficients in half precision. */
export class Plan {
  /** @param {ArrayBuffer} bytes */
  constructor(bytes) {
    const data = new DataView(bytes);
    /** @type {(at: number) => number} */
    const integer = (at) => data.getUint32(at, true);
    const [family, , columns, rows, count, members, width, height] = [
      8, 12, 16, 20, 24, 28, 32, 36,
    ].map(integer);
    this.revision = Array.from(new Uint8Array(bytes, 40, 16), (byte) =>
      byte.toString(16).padStart(2, "0"),
    ).join("");
    /** @type {Page.MeshGrid} */
    this.grid = {
      columns,
      rows,
      width,
      height,
      cell: [width / (columns - 1), height / (rows - 1)],
    };
    this.family = family;
    this.count = count;
    /** @type {(at: number) => [column: number, handle: number, place: number, share: number]} */
    const member = (at) => [
      integer(at),
      integer(at + 4),
      integer(at + 8),
      data.getFloat32(at + 12, true),
    ];
    this.members = Array.from({ length: members }, (_, k) => member(HEADER + MEMBER * k));
    const first = HEADER + MEMBER * members;
    this.numbers = Float32Array.from({ length: (bytes.byteLength - first) >> 1 }, (_, k) =>
      half(data.getUint16(first + 2 * k, true)),
    );
    this.rest = Mesh.atRest(this.grid);
  }

  /**
   * Positions of the columns: x, y of each.
   * @param {Page.WireHandle[]} handles
   */
  #columns(handles) {
    const sums = new Float64Array(2 * this.count);
    for (const [column, handle, place, share] of this.members) {
      const places = handles[handle];
      const [x, y] = isLine(places) ? places[place] : places;
      sums[2 * column] += share * x;
      sums[2 * column + 1] += share * y;
    }
    return sums;
  }

  /**
   * The posed grid, of handles in the server's form.
   * @param {Page.WireHandle[]} p
   * @param {Page.WireHandle[]} q
   */
  pose(p, q) {
    if (this.family === LINES) return this.#poseLines(p, q);
    const { family, count, numbers } = this;
    const [P, Q] = [this.#columns(p), this.#columns(q)];
    const vertices = this.grid.columns * this.grid.rows;
    const places = new Float32Array(this.rest.places);
    for (let k = 0; k < vertices; k++) {
      // The sums of B (Q - P) or C (Q - P), of w P and of w Q.
      let [mx, my, px, py, qx, qy] = [0, 0, 0, 0, 0, 0];
      for (let c = 0, at = k; c < count; c++, at += (family + 1) * vertices) {
        const [x, y] = [Q[2 * c] - P[2 * c], Q[2 * c + 1] - P[2 * c + 1]];
        const re = numbers[at];
        const im = family > 0 ? numbers[at + vertices] : 0;
        mx += re * x - im * y;
        my += re * y + im * x;
        if (family < 2) continue;
        const w = numbers[at + 2 * vertices];
        px += w * P[2 * c];
        py += w * P[2 * c + 1];
        qx += w * Q[2 * c];
        qy += w * Q[2 * c + 1];
      }
      let [x, y] = [places[2 * k] - px + mx, places[2 * k + 1] - py + my];
      if (family === 2) {
        const [before, after] = [Math.hypot(x - mx, y - my), Math.hypot(x, y)];
        // Without a direction nothing turns.
        const turned = after > 1e-5 * before;
        x = qx + (turned ? (x * before) / after : x - mx);
        y = qy + (turned ? (y * before) / after : y - my);
      }
      places[2 * k] = x;
      places[2 * k + 1] = y;
    }
    return new Mesh(this.grid, places);
  }

  /**
   * The posed grid of a method that is linear in the start, direction and normal of each segment.
   * @param {Page.WireHandle[]} p
   * @param {Page.WireHandle[]} q
   */
  #poseLines(p, q) {
    const [P, Q] = [this.#columns(p), this.#columns(q)];
    /** @type {(ends: Float64Array, at: number) => [x: number, y: number]} */
    const along = (ends, at) => [ends[at + 2] - ends[at], ends[at + 3] - ends[at + 1]];
    const terms = [];
    for (let at = 0; at < P.length; at += 4) {
      const [[x, y], [u, v]] = [along(P, at), along(Q, at)];
      const [rest, posed] = [Math.hypot(x, y), Math.hypot(u, v)];
      terms.push(
        [Q[at] - P[at], Q[at + 1] - P[at + 1]],
        [u - x, v - y],
        posed ? [y / rest - v / posed, u / posed - x / rest] : [0, 0],
      );
    }
    const vertices = this.grid.columns * this.grid.rows;
    const places = new Float32Array(this.rest.places);
    for (const [term, [x, y]] of terms.entries()) {
      for (let k = 0; k < vertices; k++) {
        const share = this.numbers[term * vertices + k];
        places[2 * k] += share * x;
        places[2 * k + 1] += share * y;
      }
    }
    return new Mesh(this.grid, places);
  }

  /**
   * The largest distance between a posed handle and where its mesh puts it, px: the lattice is
   * coarser than the grid of the server. Handles outside of the picture do not count; those that
   * coincide at rest count as one at their mean.
   * @param {Page.Mesh} mesh
   * @param {Page.WireHandle[]} p
   * @param {Page.WireHandle[]} q
   */
  residual(mesh, p, q) {
    let worst = 0;
    /** @type {(rest: Page.Place, posed: Page.Place) => void} */
    const look = (rest, posed) => {
      const drawn = mesh.forward(...rest);
      if (drawn) worst = Math.max(worst, Math.hypot(drawn[0] - posed[0], drawn[1] - posed[1]));
    };
    const [P, Q] = [this.#columns(p), this.#columns(q)];
    /** @type {(places: Float64Array, column: number) => Page.Place} */
    const of = (places, column) => [places[2 * column], places[2 * column + 1]];
    for (const [column, handle] of this.members)
      if (!isLine(p[handle])) look(of(P, column), of(Q, column));
    for (const [handle, rest] of p.entries()) {
      const posed = q[handle];
      if (!isLine(rest) || !isLine(posed)) continue;
      /** @type {(places: Page.Place[], k: number, t: number) => Page.Place} */
      const between = (places, k, t) =>
        places[k].map((c, axis) => c * (1 - t) + places[k + 1][axis] * t);
      for (let n = 0; n < SAMPLES * (rest.length - 1); n++) {
        const [k, t] = [Math.floor(n / SAMPLES), (n % SAMPLES) / (SAMPLES - 1)];
        look(between(rest, k, t), between(posed, k, t));
      }
    }
    return worst;
  }
}

/**
 * Bytes of a file.
 * @param {Page.Rest} rest
 * @param {number} vertices
 */
function bytesOf({ p, method }, vertices) {
  const columns = p.reduce(
    (sum, handle) => sum + (isLine(handle) ? 2 * (handle.length - 1) : 1),
    0,
  );
  const planes = Object.hasOwn(PLANES, method)
    ? PLANES[/** @type {keyof typeof PLANES} */ (method)]
    : 3;
  return HEADER + columns * (MEMBER + 2 * planes * vertices);
}

/** The coefficients of the current session. */
export class Plans {
  /** @type {Plan | null} */
  #plan = null;
  /** @type {AbortController | null} */
  #wanted = null; // AbortController of the requests
  /** Resolves when the first file is here, or none is expected. */
  arrived = Promise.resolve();

  /**
   * `read`: gets the file of a session, or null if there is none for it.
   * @param {(
   *   id: string,
   *   columns: number,
   *   rows: number,
   *   signal: AbortSignal,
   * ) => Promise<ArrayBuffer | null>} read
   */
  constructor(read) {
    this.read = read;
  }

  /**
   * The plan of these rest handles, or null.
   * @param {Page.Session | null} session
   */
  of(session) {
    return session?.rest && this.#plan?.revision === session.revision ? this.#plan : null;
  }

  /**
   * Requests the coefficients of a session, unless they are here. `shown`: called when a file
   * arrives.
   * @param {Page.Session} session
   * @param {() => void} shown
   */
  want(session, shown) {
    if (this.#plan?.revision === session.revision) return;
    this.drop();
    const rest = JSON.parse(session.rest ?? "null");
    // The session of a link may have other rest handles than the document.
    if (!rest || (rest.method === "tps" && rest.p.length > SPLINE)) return;
    // Inside an outline, a place of the grid may have several vertices.
    if (rest.metric === "geodesic") return;
    // The map without folds is no sum of coefficients.
    if (rest.folds === "remove") return;
    const { width, height, columns, rows } = session.grid;
    /** @type {(side: number) => number} */
    const along = (side) =>
      Math.max(2, Math.round(Math.sqrt((VERTICES * side * side) / (width * height))));
    /** @type {Page.Size} */
    const first = [along(width), along(height)];
    this.#wanted = new AbortController();
    this.arrived = this.#fetch(session, rest, first, [columns, rows], shown, this.#wanted.signal);
  }

  drop() {
    this.#wanted?.abort();
    this.#plan = null;
    this.arrived = Promise.resolve();
  }

  /**
   * @param {Page.Session} session
   * @param {Page.Rest} rest
   * @param {Page.Size} first
   * @param {Page.Size} finer
   * @param {() => void} shown
   * @param {AbortSignal} signal
   */
  async #fetch(session, rest, first, finer, shown, signal) {
    /** @type {(lattice: Page.Size) => number} */
    const bytes = ([columns, rows]) => bytesOf(rest, columns * rows);
    if (bytes(first) > LARGEST) return;
    const begun = performance.now();
    if (!(await this.#take(session, first, shown, signal))) return;
    const time = ((performance.now() - begun) * bytes(finer)) / bytes(first);
    if (bytes(finer) > bytes(first) && bytes(finer) <= LARGEST && time <= FINER)
      this.#take(session, finer, shown, signal);
  }

  /**
   * Whether a file has arrived. Without one, meshes come from the server.
   * @param {Page.Session} session
   * @param {Page.Size} lattice
   * @param {() => void} shown
   * @param {AbortSignal} signal
   */
  async #take(session, [columns, rows], shown, signal) {
    const bytes = await this.read(session.id, columns, rows, signal);
    if (!bytes || signal.aborted) return false;
    const plan = new Plan(bytes);
    if (plan.revision !== session.revision) return false;
    this.#plan = plan;
    shown();
    return true;
  }
}
