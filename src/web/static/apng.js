// Animated PNG (PNG 3rd edition, section 11.3.4): files of the engine become the frames of one file.
// The frames of a file are all with alpha or all without: those that need none are given it.

const SIGNATURE = 8;
/** Bytes of a chunk without its payload. */
const OVERHEAD = 12;
const MS_PER_SECOND = 1000;
/** The colour types with alpha of those without: grey, RGB. */
const WITH_ALPHA = new Map([
  [0, 4],
  [2, 6],
]);
/** Where IHDR has the colour type. */
const COLOUR_TYPE = 9;
/**
 * A byte of opaque alpha as each filter writes it: at the first pixel of the first row, in the first
 * row, at the first pixel of a row, and elsewhere. The bytes of other channels do not depend on it.
 */
const FILTERED = [
  [255, 255, 255, 255],
  [255, 0, 255, 0],
  [255, 255, 0, 0],
  [255, 128, 128, 0],
  [255, 0, 0, 0],
];
/** Bytes after which the page gets its turn. */
const TURN = 1 << 21;

const CRC = Uint32Array.from({ length: 256 }, (_, k) => {
  for (let bit = 0; bit < 8; bit++) k = k & 1 ? 0xedb88320 ^ (k >>> 1) : k >>> 1;
  return k;
});

const turn = () => new Promise((then) => setTimeout(then));

/** @type {(...values: number[]) => Uint8Array<ArrayBuffer>} */
const big = (...values) => {
  const bytes = new DataView(new ArrayBuffer(4 * values.length));
  values.forEach((value, k) => bytes.setUint32(4 * k, value));
  return new Uint8Array(bytes.buffer);
};

/**
 * @param {string} kind
 * @param {Uint8Array[]} payload
 */
async function chunk(kind, ...payload) {
  const length = payload.reduce((sum, part) => sum + part.length, 0);
  const bytes = new Uint8Array(length + OVERHEAD);
  bytes.set(big(length));
  let to = 4;
  for (const part of [Uint8Array.from(kind, (letter) => letter.charCodeAt(0)), ...payload]) {
    bytes.set(part, to);
    to += part.length;
  }
  let crc = -1;
  for (let k = 4; k < to; k++) {
    crc = CRC[(crc ^ bytes[k]) & 255] ^ (crc >>> 8);
    if (k % TURN === 0) await turn();
  }
  bytes.set(big(~crc >>> 0), to);
  return bytes;
}

/**
 * @param {Uint8Array<ArrayBuffer>} file
 * @returns {Generator<{ kind: string, payload: Uint8Array<ArrayBuffer> }>}
 */
function* chunksOf(file) {
  const view = new DataView(file.buffer, file.byteOffset, file.length);
  for (let at = SIGNATURE; at < file.length;) {
    const end = at + OVERHEAD + view.getUint32(at);
    const kind = String.fromCharCode(...file.subarray(at + 4, at + 8));
    yield { kind, payload: file.subarray(at + 8, end - 4) };
    at = end;
  }
}

/**
 * @param {BlobPart[]} parts
 * @param {CompressionStream | DecompressionStream} by
 */
const through = async (parts, by) =>
  new Uint8Array(await new Response(new Blob(parts).stream().pipeThrough(by)).arrayBuffer());

/**
 * The rows of an image without alpha, compressed, as those of the same image with it.
 *
 * @param {DataView} header
 * @param {Uint8Array<ArrayBuffer>[]} data
 */
async function withAlpha(header, data) {
  const [width, height] = [header.getUint32(0), header.getUint32(4)];
  const sample = header.getUint8(8) / 8;
  const colours = (header.getUint8(COLOUR_TYPE) === 2 ? 3 : 1) * sample;
  const rows = await through(data, new DecompressionStream("deflate"));
  const wider = new Uint8Array(height * (1 + width * (colours + sample)));
  let [from, to] = [0, 0];
  for (let y = 0; y < height; y++) {
    const alphas = FILTERED[rows[from]];
    wider[to++] = rows[from++];
    for (let x = 0; x < width; x++) {
      for (let k = 0; k < colours; k++) wider[to++] = rows[from++];
      const alpha = alphas[(x > 0 ? 1 : 0) + (y > 0 ? 2 : 0)];
      for (let k = 0; k < sample; k++) wider[to++] = alpha;
    }
    if (to % TURN < width * (colours + sample)) await turn();
  }
  return through([wider], new CompressionStream("deflate"));
}

export class AnimatedPng {
  #numbers = 0;
  /** @type {Uint8Array | null} */
  #header = null;

  /**
   * @param {number} frames
   * @param {number} delay how long each is shown, ms
   * @param {boolean} hasAlpha
   */
  constructor(frames, delay, hasAlpha) {
    this.frames = frames;
    this.delay = delay;
    this.hasAlpha = hasAlpha;
  }

  /**
   * What the next frame, a PNG file, adds to the file.
   *
   * @param {Uint8Array<ArrayBuffer>} file
   * @returns {Promise<Uint8Array<ArrayBuffer>[]>}
   */
  async frame(file) {
    const chunks = [...chunksOf(file)];
    const header = chunks[0].payload;
    const type = WITH_ALPHA.get(header[COLOUR_TYPE]);
    let data = chunks.filter(({ kind }) => kind === "IDAT").map(({ payload }) => payload);
    if (this.hasAlpha && type !== undefined) {
      data = [await withAlpha(new DataView(header.buffer, header.byteOffset, header.length), data)];
      header[COLOUR_TYPE] = type;
    }
    const isFirst = this.#header === null;
    this.#header ??= header;
    if (String(header) !== String(this.#header))
      throw new Error("the frames differ in size or colours");
    const control = [big(this.#numbers++), header.subarray(0, 8), big(0, 0, this.delay << 16)];
    control[2].set([MS_PER_SECOND >> 8, MS_PER_SECOND & 255], 10);
    const fcTL = await chunk("fcTL", ...control, new Uint8Array(2));
    if (!isFirst) {
      const more = data.map((payload) => chunk("fdAT", big(this.#numbers++), payload));
      return [fcTL, ...(await Promise.all(more))];
    }
    const others = chunks.filter(({ kind }) => !["IHDR", "IDAT", "IEND"].includes(kind));
    return [
      file.slice(0, SIGNATURE),
      await chunk("IHDR", header),
      await chunk("acTL", big(this.frames, 0)),
      fcTL,
      ...(await Promise.all(others.map(({ kind, payload }) => chunk(kind, payload)))),
      ...(await Promise.all(data.map((payload) => chunk("IDAT", payload)))),
    ];
  }

  /** What follows the last frame. */
  end = () => chunk("IEND");
}
