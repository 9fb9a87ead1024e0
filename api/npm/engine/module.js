// The compiled WebAssembly file: fetched and compiled once for each place.

/** @typedef {{ readFile(file: URL): Promise<Uint8Array<ArrayBuffer>> }} FileSystem */
/** @typedef {{ getBuiltinModule(name: string): FileSystem }} Process that of Node */
/** @typedef {URL | string | Response | BufferSource | WebAssembly.Module} Source */

/** @type {Map<string, Promise<WebAssembly.Module>>} */
const compiled = new Map();

/**
 * @param {Source} [source]
 * @returns {Promise<WebAssembly.Module>}
 */
export async function moduleOf(source) {
  // Bundlers look for this expression as it stands, and copy the file.
  source ??= new URL("../mlswarp.wasm", import.meta.url);
  if (source instanceof WebAssembly.Module) return source;
  if (source instanceof Response) return compile(source);
  if (typeof source !== "string" && !(source instanceof URL)) return WebAssembly.compile(source);
  const place = String(source);
  const known = compiled.get(place);
  if (known) return known;
  const module = fetched(place);
  compiled.set(place, module);
  // A network that failed may work at the next call.
  module.catch(() => compiled.delete(place));
  return module;
}

/** @param {string} place */
async function fetched(place) {
  if (place.startsWith("file:")) {
    // Not an import: bundlers for browsers would look for it. Node 20.16 or later.
    const { process } = /** @type {{ process: Process }} */ (/** @type {unknown} */ (globalThis));
    const { readFile } = process.getBuiltinModule("node:fs/promises");
    return WebAssembly.compile(await readFile(new URL(place)));
  }
  return compile(await fetch(place));
}

/** @param {Response} response */
async function compile(response) {
  if (!response.ok)
    throw new Error(`cannot load mlswarp.wasm: ${response.url} answered ${response.status}`);
  const isWasm = /^application\/wasm\b/i.test(response.headers.get("Content-Type") ?? "");
  // Servers that do not know the ending send another type, which a stream is refused for.
  return isWasm
    ? WebAssembly.compileStreaming(response)
    : WebAssembly.compile(await response.arrayBuffer());
}
