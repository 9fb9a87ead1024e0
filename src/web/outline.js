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

/**
 * The distance of a place from a square, per axis.
 * @type {(at: number, low: number, side: number) => number}
 */
const beside = (at, low, side) => Math.max(0, low - at, at - low - side);

export class Inside {
  /** @type {[x: number, y: number][]} */
  #blocks = [];

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
    for (let y = 0; y < this.height; y += BLOCK)
      for (let x = 0; x < width; x += BLOCK) if (this.#hasAny(x, y)) this.#blocks.push([x, y]);
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

  /** @type {(left: number, top: number) => boolean} */
  #hasAny(left, top) {
    for (let y = top; y < top + BLOCK; y++)
      for (let x = left; x < left + BLOCK; x++) if (this.#isInside(x, y)) return true;
    return false;
  }

  /**
   * The place itself if it is inside, otherwise the middle of the nearest pixel, and how far away
   * that is, px of the picture; null if nothing is inside.
   * @param {Page.Place} place
   * @returns {{ place: Page.Place, away: number } | null}
   */
  #nearest(place) {
    const [x, y] = place.map((c) => c * this.scale);
    if (this.#isInside(Math.floor(x), Math.floor(y))) return { place, away: 0 };
    /**
     * The square of the distance.
     * @type {(left: number, top: number, side: number) => number}
     */
    const away = (left, top, side) => beside(x, left, side) ** 2 + beside(y, top, side) ** 2;
    let least = Infinity;
    let best = /** @type {Page.Place} */ (place);
    /** @type {(block: [number, number]) => void} */
    const search = ([left, top]) => {
      for (let v = top; v < top + BLOCK; v++)
        for (let u = left; u < left + BLOCK; u++) {
          const far = away(u, v, 1);
          if (far < least && this.#isInside(u, v)) [least, best] = [far, [u + 0.5, v + 0.5]];
        }
    };
    // The nearest block first: it excludes most of the others.
    let first = null;
    let nearest = Infinity;
    for (const block of this.#blocks) {
      const far = away(...block, BLOCK);
      if (far < nearest) [first, nearest] = [block, far];
    }
    if (!first) return null;
    search(first);
    for (const block of this.#blocks) if (away(...block, BLOCK) < least) search(block);
    return { place: best.map((c) => c / this.scale), away: Math.sqrt(least) / this.scale };
  }

  /**
   * The place itself if a handle can be there, otherwise the nearest one that is at most `reach`
   * px away; null if there is none.
   * @param {Page.Place} place
   * @param {number} [reach]
   * @returns {Page.Place | null}
   */
  placeFor(place, reach = Infinity) {
    const found = this.#nearest(place);
    if (!found || found.away > Math.max(NEAR, reach)) return null;
    return found.away <= NEAR ? place : found.place;
  }

  /**
   * Whether lines between these places stay inside.
   * @param {Page.Place[]} places
   */
  sees(places) {
    return places.every((b, k) => {
      const a = places[Math.max(0, k - 1)];
      const steps = Math.ceil(this.scale * Math.hypot(b[0] - a[0], b[1] - a[1])) || 1;
      return Array.from({ length: steps + 1 }, (_, n) => n / steps).every((t) => {
        const [x, y] = a.map((c, axis) => Math.floor(this.scale * (c + t * (b[axis] - c))));
        // The ends may be beside the inside, and a reduced picture has lost what is thin.
        const slack = t * steps <= NEAR || (1 - t) * steps <= NEAR ? NEAR + 1 : 1;
        for (let v = y - slack; v <= y + slack; v++)
          for (let u = x - slack; u <= x + slack; u++) if (this.#isInside(u, v)) return true;
        return false;
      });
    });
  }

  /**
   * Indices of the handles that are not inside.
   * @param {Page.Handle[]} handles
   */
  beside(handles) {
    return handles.flatMap(({ p }, index) =>
      p.every((place) => this.placeFor(place) === place) && this.sees(p) ? [] : [index],
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
 *   threshold: number,
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
  const { parts, feather } = regionOf(document);
  if (!isOutlined(document) || !view.size || !isDecoded(parts)) return null;
  const threshold = thresholdOf(document);
  const original = inStage(view.stage, "original");
  const old = kept.get(view);
  if (
    old?.original === original &&
    old.parts === parts &&
    old.feather === feather &&
    old.threshold === threshold
  )
    return old.inside;
  const scale = Math.min(1, Math.sqrt(MOST / (view.size[0] * view.size[1])));
  const canvas = globalThis.document.createElement("canvas");
  const [width, height] = view.size.map((side) => Math.max(1, Math.round(side * scale)));
  Object.assign(canvas, { width, height });
  const context = contextOf(canvas, { willReadFrequently: true });
  context.drawImage(original, 0, 0, width, height);
  if (parts.length) {
    context.globalCompositeOperation = "destination-in";
    context.drawImage(maskOf({ parts, feather }, view.size, scale), 0, 0, width, height);
  }
  const { data } = context.getImageData(0, 0, width, height);
  const alpha = Uint8Array.from({ length: width * height }, (_, k) => data[4 * k + 3]);
  const inside = new Inside(alpha, width, scale, 255 * threshold);
  kept.set(view, { original, parts, feather, threshold, inside });
  return inside;
}
