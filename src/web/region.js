// The region: the part of the picture that moves. In the document it is a list of parts, drawn one
// over the other, and a feather; the server gets it as a mask, white where content moves. Without
// parts the whole picture moves. Positions are those at rest.
//
// A part is { kind: "lasso", removes, places }, { kind: "brush", removes, places, size }, { kind:
// "invert" } or, from a session that another page has made or from a file of handles, { kind:
// "mask", png (base64) }.

import { contextOf } from "./dom.js";

/** @type {Page.RegionPart[]} */
const NONE = [];

/** @type {(tool: Page.Tool) => tool is "lasso" | "brush"} */
export const isRegionTool = (tool) => tool === "lasso" || tool === "brush";

/**
 * Parts and feather of a document. Documents of older pages lack them.
 * @type {(document: Pick<Page.Document, "region" | "feather">) => Page.Region}
 */
export const regionOf = ({ region, feather }) => ({ parts: region ?? NONE, feather: feather ?? 0 });

/**
 * Whether two regions are the same one: parts are never changed, only replaced.
 * @type {(a: Page.Region, b: Page.Region) => boolean}
 */
export const sameRegion = (a, b) =>
  (!a.parts.length && !b.parts.length) || (a.parts === b.parts && a.feather === b.feather);

/**
 * The document with one more part. If the whole picture moves, a part that removes begins with the
 * whole picture.
 * @param {Page.Document} document
 * @param {Page.RegionPart} part
 * @returns {Page.Document}
 */
export function withPart(document, part) {
  const { parts } = regionOf(document);
  /** @type {Page.RegionPart[]} */
  const before =
    !parts.length && (part.removes || part.kind === "invert") ? [{ kind: "invert" }] : parts;
  return { ...document, region: [...before, part] };
}

/** @type {(document: Page.Document) => Page.Document} */
export const withoutRegion = (document) => ({ ...document, region: NONE });

/**
 * The size of the brush, px of the picture.
 * @type {(state: Pick<Page.State, "brush" | "picture">) => number}
 */
export const brushSizeOf = ({ brush, picture }) =>
  brush ?? (picture ? Math.max(4, Math.round((picture.width + picture.height) / 20)) : 1);

/**
 * The part that the lasso or the brush has drawn along a path; null if it has no area. `most`: the
 * tolerance of its simplification, px.
 * @param {Page.State} state
 * @param {Page.Place[]} places
 * @param {number} [most]
 * @returns {Page.RegionPart | null}
 */
export function partOf(state, places, most = 0) {
  const { tool, removes } = state;
  if (tool === "lasso" && isFlat(places, most)) return null;
  const drawn = { removes, places: simplified(places, most) };
  return tool === "brush"
    ? { kind: "brush", ...drawn, size: brushSizeOf(state) }
    : { kind: "lasso", ...drawn };
}

/**
 * Whether places lie on a line, to `most` px.
 * @param {Page.Place[]} places
 * @param {number} most
 */
function isFlat(places, most) {
  const [[ax, ay]] = places.length ? places : [[0, 0]];
  /** @type {(place: Page.Place) => number} */
  const away = ([x, y]) => Math.hypot(x - ax, y - ay);
  /** @type {Page.Place} */
  const far = places.reduce((a, b) => (away(b) > away(a) ? b : a), [ax, ay]);
  return places.every(
    ([x, y]) => Math.abs((far[0] - ax) * (y - ay) - (far[1] - ay) * (x - ax)) <= most * away(far),
  );
}

/** @type {(x: number) => number} */
const tenth = (x) => Math.round(10 * x) / 10;

/**
 * Simplifies a path within a tolerance of `most` px (Ramer, Douglas and Peucker), and rounds it to
 * a tenth.
 * @param {Page.Place[]} places
 * @param {number} most
 * @returns {Page.Place[]}
 */
export function simplified(places, most) {
  const keep = new Set([0, places.length - 1]);
  const open = [[0, places.length - 1]];
  while (open.length) {
    const [from, to] = /** @type {number[]} */ (open.pop());
    let [far, at] = [most, -1];
    for (let k = from + 1; k < to; k++) {
      const away = distance(places[k], places[from], places[to]);
      if (away > far) [far, at] = [away, k];
    }
    if (at < 0) continue;
    keep.add(at);
    open.push([from, at], [at, to]);
  }
  return places.filter((_, k) => keep.has(k)).map((place) => place.map(tenth));
}

/**
 * @param {Page.Place} place
 * @param {Page.Place} from
 * @param {Page.Place} to
 */
function distance([x, y], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const length = dx * dx + dy * dy;
  const t = length ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}

// Drawing: white on transparent, at a scale.

/**
 * Decoded masks by their base64.
 * @type {Map<string, HTMLCanvasElement>}
 */
const decoded = new Map();

/**
 * Decodes the masks of a region, which `maskOf` needs.
 * @param {Page.RegionPart[]} parts
 */
export async function decodeParts(parts) {
  for (const part of parts) {
    if (part.kind !== "mask" || decoded.has(part.png)) continue;
    const image = Object.assign(new Image(), { src: `data:image/png;base64,${part.png}` });
    await image.decode();
    decoded.set(part.png, whiteByLuma(image));
  }
}

/**
 * The sides of a decoded mask, px.
 * @type {(part: { png: string }) => Page.Size}
 */
export const sizeOfMask = (part) => {
  const { width, height } = drawnMask(part);
  return [width, height];
};

/** @type {(part: { png: string }) => HTMLCanvasElement} */
function drawnMask({ png }) {
  const mask = decoded.get(png);
  if (!mask) throw new Error("the mask is not decoded");
  return mask;
}

/**
 * The part that is a mask of the server.
 * @param {Blob} blob
 * @returns {Promise<{ kind: "mask", png: string }>}
 */
export async function maskPart(blob) {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  return {
    kind: "mask",
    png: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")),
  };
}

/**
 * Whether every mask of a region is decoded.
 * @type {(parts: Page.RegionPart[]) => boolean}
 */
export const isDecoded = (parts) =>
  parts.every((part) => part.kind !== "mask" || decoded.has(part.png));

/**
 * @param {number} width
 * @param {number} height
 */
function canvasOf(width, height) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  return contextOf(canvas, { willReadFrequently: true });
}

/**
 * A grey opaque picture as white, with its brightness as alpha.
 * @param {HTMLImageElement} image
 */
function whiteByLuma(image) {
  const context = canvasOf(image.naturalWidth, image.naturalHeight);
  const { width, height } = context.canvas;
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, width, height);
  for (let k = 0; k < pixels.data.length; k += 4) {
    pixels.data[k + 3] = pixels.data[k];
    pixels.data[k] = pixels.data[k + 1] = pixels.data[k + 2] = 255;
  }
  context.putImageData(pixels, 0, 0);
  return context.canvas;
}

/** @type {(context: CanvasRenderingContext2D) => unknown} */
const prepare = (context) =>
  Object.assign(context, {
    fillStyle: "#fff",
    strokeStyle: "#fff",
    lineCap: "round",
    lineJoin: "round",
  });

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Page.RegionPart} part
 * @param {Page.Size} size
 */
function drawPart(context, part, [width, height]) {
  context.globalCompositeOperation =
    part.kind === "invert" ? "xor" : part.removes ? "destination-out" : "source-over";
  if (part.kind === "invert") context.fillRect(0, 0, width, height);
  else if (part.kind === "mask") context.drawImage(drawnMask(part), 0, 0);
  else {
    const { places } = part;
    context.beginPath();
    for (const place of places) context.lineTo(...place);
    if (part.kind === "lasso") return context.fill();
    // A line of no length is not drawn.
    if (places.length === 1) context.lineTo(places[0][0], places[0][1] + 0.01);
    context.lineWidth = part.size;
    context.stroke();
  }
}

/**
 * A canvas with the mask of a region as white and alpha, `scale` times as large as the picture.
 * @param {Page.Region} region
 * @param {Page.Size} size
 * @param {number} [scale]
 */
export function maskOf({ parts, feather }, size, scale = 1) {
  const context = canvasOf(...size.map((side) => Math.max(1, Math.floor(side * scale))));
  const { width, height } = context.canvas;
  context.scale(width / size[0], height / size[1]);
  prepare(context);
  for (const part of parts) drawPart(context, part, size);
  const radius = Math.round((feather * scale) / 4);
  if (radius > 0) {
    const pixels = context.getImageData(0, 0, width, height);
    blurAlpha(pixels, radius);
    context.putImageData(pixels, 0, 0);
  }
  return context.canvas;
}

/**
 * Two means over 2 radius + 1 pixels in each direction: an edge becomes a smooth transition of
 * about 4 radius px. White stays white.
 * @param {ImageData} pixels
 * @param {number} radius
 */
function blurAlpha({ data, width, height }, radius) {
  let [from, to] = [new Uint8ClampedArray(width * height), new Uint8ClampedArray(width * height)];
  for (let k = 0; k < from.length; k++) from[k] = data[4 * k + 3];
  for (const mean of [meanAcross, meanAcross, meanDown, meanDown]) {
    mean(from, to, width, radius);
    [from, to] = [to, from];
  }
  for (let k = 0; k < from.length; k++) {
    data[4 * k] = data[4 * k + 1] = data[4 * k + 2] = 255;
    data[4 * k + 3] = from[k];
  }
}

/**
 * The moving mean along the rows; a row continues with its ends.
 * @param {Uint8ClampedArray} from
 * @param {Uint8ClampedArray} to
 * @param {number} width
 * @param {number} radius
 */
function meanAcross(from, to, width, radius) {
  for (let start = 0; start < from.length; start += width) {
    const last = start + width - 1;
    let sum = 0;
    for (let k = start - radius; k <= start + radius; k++)
      sum += from[Math.min(last, Math.max(start, k))];
    for (let k = start; k <= last; k++) {
      to[k] = sum / (2 * radius + 1);
      sum += from[Math.min(last, k + radius + 1)] - from[Math.max(start, k - radius)];
    }
  }
}

/**
 * The moving mean along the columns, all of them at once: memory is read row by row.
 * @param {Uint8ClampedArray} from
 * @param {Uint8ClampedArray} to
 * @param {number} width
 * @param {number} radius
 */
function meanDown(from, to, width, radius) {
  const last = from.length - width;
  /** @type {(row: number) => number} */
  const at = (row) => Math.min(last, Math.max(0, row * width));
  const sums = new Float64Array(width);
  for (let row = -radius; row <= radius; row++)
    for (let x = 0, k = at(row); x < width; x++, k++) sums[x] += from[k];
  for (let row = 0; row * width <= last; row++) {
    const [here, first, next] = [at(row), at(row - radius), at(row + radius + 1)];
    for (let x = 0; x < width; x++) {
      to[here + x] = sums[x] / (2 * radius + 1);
      sums[x] += from[next + x] - from[first + x];
    }
  }
}

/**
 * A copy of a mask with one more part.
 * @param {HTMLCanvasElement} mask
 * @param {Page.RegionPart} part
 * @param {Page.Size} size
 */
export function withStroke(mask, part, size) {
  const context = canvasOf(mask.width, mask.height);
  context.drawImage(mask, 0, 0);
  context.scale(mask.width / size[0], mask.height / size[1]);
  prepare(context);
  drawPart(context, part, size);
  return context.canvas;
}

/**
 * The mask as a file for the server: white on black, of the picture's size.
 * @param {Page.Region} region
 * @param {Page.Size} size
 * @returns {Promise<Blob>}
 */
export async function maskFile(region, size) {
  await decodeParts(region.parts);
  const context = canvasOf(...size);
  context.fillRect(0, 0, ...size);
  context.drawImage(maskOf(region, size), 0, 0);
  return new Promise((resolve, reject) =>
    context.canvas.toBlob(
      (blob) => (blob ? resolve(blob) : reject(new Error("the mask is too large for a canvas"))),
      "image/png",
    ),
  );
}
