// What is inside of an outline, where handles can be: the alpha of the picture, times the region, is
// above the threshold. The server decides; the page says it before, and finds the nearest place.

import { contextOf, inStage } from "./dom.js";
import { isOutlined, rounded, thresholdOf } from "./edits.js";
import { isDecoded, maskOf, regionOf } from "./region.js";

/** Pixels of the copy that is looked at; a larger picture is reduced to them. */
const MOST = 1 << 24;
/** The server takes what is this near to the inside, px. */
const NEAR = 3;
/** Handles that are beside it by more than this share of the longest side belong elsewhere. */
const MOST_BESIDE = 0.05;
/** Sides of the squares that are looked at before their pixels. */
const BLOCK = 16;

/** Pixels that are read at once. */
const BAND = 1 << 20;

/**
 * The distance of a place from a square, per axis.
 * @type {(at: number, low: number, side: number) => number}
 */
const beside = (at, low, side) => Math.max(0, low - at, at - low - side);

export class Inside {
  /**
   * `alpha`: of each pixel, row by row, `scale` times as many along a side as the picture has;
   * `least`: those above it are inside.
   * @param {Uint8Array} alpha
   * @param {number} width
   * @param {number} scale
   * @param {number} least
   */
  constructor(alpha, width, scale, least) {
    this.alpha = alpha;
    this.width = width;
    this.height = alpha.length / width;
    this.scale = scale;
    this.least = least;
    this.columns = Math.ceil(width / BLOCK);
    this.rows = Math.ceil(this.height / BLOCK);
    /** Which blocks have a pixel inside: 0 is not known yet, 1 no, 2 yes. */
    this.blocks = new Uint8Array(this.columns * this.rows);
  }

  /** @type {(x: number, y: number) => boolean} */
  #isInside(x, y) {
    return (
      x >= 0 &&
      y >= 0 &&
      x < this.width &&
      y < this.height &&
      this.alpha[y * this.width + x] > this.least
    );
  }

  /** @type {(column: number, row: number) => boolean} */
  #hasAny(column, row) {
    const { alpha, width, least, blocks } = this;
    const block = row * this.columns + column;
    if (blocks[block]) return blocks[block] === 2;
    blocks[block] = 1;
    const right = Math.min(width, (column + 1) * BLOCK);
    const bottom = Math.min(this.height, (row + 1) * BLOCK);
    for (let y = row * BLOCK; y < bottom; y++)
      for (let k = y * width + column * BLOCK; k < y * width + right; k++)
        if (alpha[k] > least) {
          blocks[block] = 2;
          return true;
        }
    return false;
  }

  /**
   * The place itself if it is inside, otherwise the middle of the nearest pixel, and how far away
   * that is, px of the picture; null if nothing is inside that is at most `reach` px away.
   * @param {Page.Place} place
   * @param {number} reach
   * @returns {{ place: Page.Place, away: number } | null}
   */
  #nearest(place, reach) {
    const [x, y] = place.map((c) => c * this.scale);
    if (this.#isInside(Math.floor(x), Math.floor(y))) return { place, away: 0 };
    /**
     * The square of the distance.
     * @type {(left: number, top: number, side: number) => number}
     */
    const away = (left, top, side) => beside(x, left, side) ** 2 + beside(y, top, side) ** 2;
    let least = (reach * this.scale) ** 2;
    /** @type {Page.Place[]} */
    const best = [];
    /** @type {(column: number, row: number) => void} */
    const search = (column, row) => {
      const [left, top] = [column * BLOCK, row * BLOCK];
      if (away(left, top, BLOCK) > least || !this.#hasAny(column, row)) return;
      for (let v = top; v < top + BLOCK; v++)
        for (let u = left; u < left + BLOCK; u++) {
          const far = away(u, v, 1);
          if (far <= least && this.#isInside(u, v)) [least, best[0]] = [far, [u + 0.5, v + 0.5]];
        }
    };
    // Rings of blocks around the place, until the next one is farther away than what is found.
    const { columns, rows } = this;
    const column = Math.min(columns - 1, Math.max(0, Math.floor(x / BLOCK)));
    const row = Math.min(rows - 1, Math.max(0, Math.floor(y / BLOCK)));
    for (let ring = 0; ring < Math.max(columns, rows); ring++) {
      if ((BLOCK * Math.max(0, ring - 1)) ** 2 > least) break;
      for (let r = Math.max(0, row - ring); r <= Math.min(rows - 1, row + ring); r++) {
        const step = Math.abs(r - row) === ring ? 1 : 2 * ring;
        for (let c = column - ring; c <= column + ring; c += step)
          if (c >= 0 && c < columns) search(c, r);
      }
    }
    if (!best.length) return null;
    return { place: best[0].map((c) => c / this.scale), away: Math.sqrt(least) / this.scale };
  }

  /**
   * The place itself if a handle can be there, otherwise the nearest one that is at most `reach`
   * px away; null if there is none.
   * @param {Page.Place} place
   * @param {number} [reach]
   * @returns {Page.Place | null}
   */
  placeFor(place, reach = Infinity) {
    const found = this.#nearest(place, Math.max(NEAR, reach));
    return found && (found.away <= NEAR ? place : found.place);
  }

  /**
   * Whether lines between these places stay inside.
   * @param {Page.Place[]} places
   */
  sees(places) {
    return places.every((b, k) => {
      const a = places[Math.max(0, k - 1)];
      const steps = Math.ceil(this.scale * Math.hypot(b[0] - a[0], b[1] - a[1])) || 1;
      for (let n = 0; n <= steps; n++) {
        const [x, y] = a.map((c, axis) => this.scale * (c + (n / steps) * (b[axis] - c)));
        // The ends may be beside the inside, and a reduced picture has lost what is thin.
        const slack = n <= NEAR || steps - n <= NEAR ? NEAR + 1 : 1;
        if (!this.#isAny(Math.floor(x), Math.floor(y), slack)) return false;
      }
      return true;
    });
  }

  /**
   * Whether a pixel is inside, or one that is at most `slack` beside it along each axis.
   * @type {(x: number, y: number, slack: number) => boolean}
   */
  #isAny(x, y, slack) {
    if (this.#isInside(x, y)) return true;
    for (let v = y - slack; v <= y + slack; v++)
      for (let u = x - slack; u <= x + slack; u++) if (this.#isInside(u, v)) return true;
    return false;
  }

  /**
   * Indices of the handles that are not inside.
   * @param {Page.Handle[]} handles
   */
  beside(handles) {
    return handles.flatMap(({ p }, index) =>
      p.every((place) => this.placeFor(place, 0) === place) && this.sees(p) ? [] : [index],
    );
  }

  /**
   * The handles with every place at rest inside; each keeps its displacement. Null if one lies far
   * from what is inside, or is a line that leaves it.
   * @param {Page.Handle[]} handles
   * @returns {Page.Handle[] | null}
   */
  moved(handles) {
    const reach = (MOST_BESIDE * Math.max(this.width, this.height)) / this.scale;
    const next = handles.map((handle) => {
      const p = handle.p.map((place) => this.placeFor(place, reach) ?? place);
      if (p.every((place, k) => place === handle.p[k])) return handle;
      /** @type {(place: Page.Place, k: number) => Page.Place} */
      const along = (place, k) => place.map((c, axis) => c + p[k][axis] - handle.p[k][axis]);
      return { ...handle, p: p.map(rounded), q: handle.q.map((q, k) => rounded(along(q, k))) };
    });
    return this.beside(next).length ? null : next;
  }
}

/**
 * @typedef {{
 *   original: Element,
 *   parts: Page.RegionPart[],
 *   feather: number,
 *   inside: Inside,
 * }} Known
 */

/** @type {WeakMap<Page.View, Known>} */
const kept = new WeakMap();

/**
 * What is inside for the handles of a document; null without an outline, or if it is not known.
 * @param {Page.View} view
 * @param {Page.Document} document
 */
export function insideOf(view, document) {
  const { parts, feather: soft } = regionOf(document);
  if (!isOutlined(document) || !view.size || !isDecoded(parts)) return null;
  // Without a region there is nothing that it softens.
  const feather = parts.length ? soft : 0;
  const least = 255 * thresholdOf(document);
  const original = inStage(view.stage, "original");
  const old = kept.get(view);
  const isSame = old?.original === original && old.parts === parts && old.feather === feather;
  if (isSame && old.inside.least === least) return old.inside;
  const { alpha, width, scale } = isSame
    ? old.inside
    : alphaOf(original, { parts, feather }, view.size);
  const inside = new Inside(alpha, width, scale, least);
  kept.set(view, { original, parts, feather, inside });
  return inside;
}

/**
 * The alpha of a picture times that of its region.
 * @param {HTMLImageElement} original
 * @param {Page.Region} region
 * @param {Page.Size} size
 */
function alphaOf(original, region, size) {
  const scale = Math.min(1, Math.sqrt(MOST / (size[0] * size[1])));
  const canvas = document.createElement("canvas");
  // Rounded down: with one more pixel than some browsers permit, a canvas is blank.
  const [width, height] = size.map((side) => Math.max(1, Math.floor(side * scale)));
  Object.assign(canvas, { width, height });
  const context = contextOf(canvas, { willReadFrequently: true });
  context.drawImage(original, 0, 0, width, height);
  if (region.parts.length) {
    context.globalCompositeOperation = "destination-in";
    context.drawImage(maskOf(region, size, scale), 0, 0, width, height);
  }
  const alpha = new Uint8Array(width * height);
  // In bands: the whole would be four times as large once more.
  const rows = Math.max(1, Math.floor(BAND / width));
  for (let top = 0, k = 0; top < height; top += rows) {
    const { data } = context.getImageData(0, top, width, Math.min(rows, height - top));
    for (let from = 3; from < data.length; from += 4) alpha[k++] = data[from];
  }
  return { alpha, width, scale };
}
