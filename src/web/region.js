// The region: the part of the picture that moves. In the document it is a list of parts, drawn one
// over the other, and a feather; the server gets it as a mask, white where content moves. Without
// parts the whole picture moves. Positions are those at rest.
//
// A part is { kind: "lasso", removes, places }, { kind: "brush", removes, places, size }, { kind:
// "invert" } or, from a session that another page has made or from a file of handles, { kind:
// "mask", png (base64) }.

const NONE = [];

export const isRegionTool = (tool) => tool === "lasso" || tool === "brush";

/** Parts and feather of a document. Documents of older pages lack them. */
export const regionOf = ({ region, feather }) => ({ parts: region ?? NONE, feather: feather ?? 0 });

/** Whether two regions are the same one: parts are never changed, only replaced. */
export const sameRegion = (a, b) =>
  (!a.parts.length && !b.parts.length) || (a.parts === b.parts && a.feather === b.feather);

/**
 * The document with one more part. If the whole picture moves, a part that removes begins with the
 * whole picture.
 */
export function withPart(document, part) {
  const { parts } = regionOf(document);
  const before =
    !parts.length && (part.removes || part.kind === "invert") ? [{ kind: "invert" }] : parts;
  return { ...document, region: [...before, part] };
}

export const withoutRegion = (document) => ({ ...document, region: NONE });

/** The size of the brush, px of the picture. */
export const brushSizeOf = ({ brush, picture }) =>
  brush ?? (picture ? Math.max(4, Math.round((picture.width + picture.height) / 20)) : 1);

/**
 * The part that the lasso or the brush has drawn along a path; null if it has no area. `most`: the
 * tolerance of its simplification, px.
 */
export function partOf(state, places, most = 0) {
  const { tool, removes } = state;
  if (tool === "lasso" && isFlat(places, most)) return null;
  const drawn = { kind: tool, removes, places: simplified(places, most) };
  return tool === "brush" ? { ...drawn, size: brushSizeOf(state) } : drawn;
}

/** Whether places lie on a line, to `most` px. */
function isFlat(places, most) {
  const [[ax, ay]] = places.length ? places : [[0, 0]];
  const away = ([x, y]) => Math.hypot(x - ax, y - ay);
  const far = places.reduce((a, b) => (away(b) > away(a) ? b : a), [ax, ay]);
  return places.every(
    ([x, y]) => Math.abs((far[0] - ax) * (y - ay) - (far[1] - ay) * (x - ax)) <= most * away(far),
  );
}

const tenth = (x) => Math.round(10 * x) / 10;

/**
 * Simplifies a path within a tolerance of `most` px (Ramer, Douglas and Peucker), and rounds it to
 * a tenth.
 */
export function simplified(places, most) {
  const keep = new Set([0, places.length - 1]);
  const open = [[0, places.length - 1]];
  while (open.length) {
    const [from, to] = open.pop();
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

function distance([x, y], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const length = dx * dx + dy * dy;
  const t = length ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}

// Drawing: white on transparent, at a scale.

/** Decoded masks by their base64. */
const decoded = new Map();

/** Decodes the masks of a region, which `maskOf` needs. */
export async function decodeParts(parts) {
  for (const { png } of parts.filter(({ kind, png }) => kind === "mask" && !decoded.has(png))) {
    const image = Object.assign(new Image(), { src: `data:image/png;base64,${png}` });
    await image.decode();
    decoded.set(png, whiteByLuma(image));
  }
}

/** The sides of a decoded mask, px. */
export const sizeOfMask = ({ png }) => [decoded.get(png).width, decoded.get(png).height];

/** The part that is a mask of the server. */
export async function maskPart(blob) {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  return {
    kind: "mask",
    png: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")),
  };
}

/** Whether every mask of a region is decoded. */
export const isDecoded = (parts) =>
  parts.every(({ kind, png }) => kind !== "mask" || decoded.has(png));

function canvasOf(width, height) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  return canvas.getContext("2d", { willReadFrequently: true });
}

/** A grey opaque picture as white, with its brightness as alpha. */
function whiteByLuma(image) {
  const context = canvasOf(image.naturalWidth, image.naturalHeight);
  const { width, height } = context.canvas;
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, width, height);
  for (let k = 0; k < pixels.data.length; k += 4) {
    pixels.data[k + 3] = pixels.data[k];
    pixels.data.fill(255, k, k + 3);
  }
  context.putImageData(pixels, 0, 0);
  return context.canvas;
}

const prepare = (context) =>
  Object.assign(context, {
    fillStyle: "#fff",
    strokeStyle: "#fff",
    lineCap: "round",
    lineJoin: "round",
  });

function drawPart(context, part, [width, height]) {
  const { kind, removes, places } = part;
  context.globalCompositeOperation =
    kind === "invert" ? "xor" : removes ? "destination-out" : "source-over";
  if (kind === "invert") context.fillRect(0, 0, width, height);
  else if (kind === "mask") context.drawImage(decoded.get(part.png), 0, 0);
  else {
    context.beginPath();
    for (const place of places) context.lineTo(...place);
    if (kind === "lasso") return context.fill();
    // A line of no length is not drawn.
    if (places.length === 1) context.lineTo(places[0][0], places[0][1] + 0.01);
    context.lineWidth = part.size;
    context.stroke();
  }
}

/** A canvas with the mask of a region as white and alpha, `scale` times as large as the picture. */
export function maskOf({ parts, feather }, size, scale = 1) {
  const context = canvasOf(...size.map((side) => Math.max(1, Math.round(side * scale))));
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
 */
function blurAlpha({ data, width, height }, radius) {
  let [from, to] = [new Uint8ClampedArray(width * height), new Uint8ClampedArray(width * height)];
  for (let k = 0; k < from.length; k++) from[k] = data[4 * k + 3];
  for (const [lines, length, next, step] of [
    [height, width, width, 1],
    [height, width, width, 1],
    [width, height, 1, width],
    [width, height, 1, width],
  ]) {
    for (let line = 0; line < lines; line++) meanLine(from, to, line * next, length, step, radius);
    [from, to] = [to, from];
  }
  for (let k = 0; k < from.length; k++) {
    data[4 * k + 3] = from[k];
    data.fill(255, 4 * k, 4 * k + 3);
  }
}

/** The moving mean of a line; the line continues with its ends. */
function meanLine(from, to, start, length, step, radius) {
  const at = (k) => from[start + step * Math.min(length - 1, Math.max(0, k))];
  let sum = 0;
  for (let k = -radius; k <= radius; k++) sum += at(k);
  for (let k = 0; k < length; k++) {
    to[start + step * k] = sum / (2 * radius + 1);
    sum += at(k + radius + 1) - at(k - radius);
  }
}

/** A copy of a mask with one more part. */
export function withStroke(mask, part, size) {
  const context = canvasOf(mask.width, mask.height);
  context.drawImage(mask, 0, 0);
  context.scale(mask.width / size[0], mask.height / size[1]);
  prepare(context);
  drawPart(context, part, size);
  return context.canvas;
}

/** The mask as a file for the server: white on black, of the picture's size. */
export async function maskFile(region, size) {
  await decodeParts(region.parts);
  const context = canvasOf(...size);
  context.fillRect(0, 0, ...size);
  context.drawImage(maskOf(region, size), 0, 0);
  return new Promise((resolve) => context.canvas.toBlob(resolve, "image/png"));
}
