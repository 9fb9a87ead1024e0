// A file that the server has drawn, and the figures in its headers.

/** @typedef {{ x: number, y: number, width: number, height: number }} Box */

/**
 * `residual`: the largest distance between a handle and where it was drawn, px. `canvas`: the part
 * of the posed plane that the picture shows; null: that of the source. `timing`: ms.
 *
 * @typedef {{
 *   blob: Blob,
 *   folds: number,
 *   residual: number | null,
 *   warnings: string[],
 *   canvas: Box | null,
 *   timing: Record<string, number>,
 *   etag: string | null,
 *   requestId: string | null,
 * }} Rendered
 */

/**
 * @param {Response} response
 * @returns {Promise<Rendered>}
 */
export async function rendered(response) {
  const { headers } = response;
  /** @type {(name: string) => string[]} */
  const list = (name) => (headers.get(name) ?? "").split(/\s*,\s*/).filter(Boolean);
  const residual = headers.get("Warp-Residual");
  const [x, y, width, height] = list("Warp-Canvas").map(Number);
  const timing = list("Server-Timing").map((entry) => {
    const [name, ms] = entry.split(/\s*;\s*dur=/);
    return [name, Number(ms)];
  });
  return {
    blob: await response.blob(),
    folds: Number(headers.get("Warp-Folds") ?? 0),
    residual: residual === null ? null : Number(residual),
    warnings: list("Warp-Warning"),
    canvas: headers.has("Warp-Canvas") ? { x, y, width, height } : null,
    timing: Object.fromEntries(timing),
    etag: headers.get("ETag"),
    requestId: headers.get("X-Request-Id"),
  };
}

const LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

/**
 * Little-endian f32 from a byte offset, a copy.
 *
 * @param {ArrayBuffer} bytes
 * @param {number} from
 */
export function floats(bytes, from) {
  const part = bytes.slice(from);
  if (LITTLE_ENDIAN) return new Float32Array(part);
  const view = new DataView(part);
  return Float32Array.from({ length: part.byteLength >> 2 }, (_, k) =>
    view.getFloat32(4 * k, true),
  );
}
