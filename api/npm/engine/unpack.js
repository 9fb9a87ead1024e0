// A WebAssembly file that comes as text.

/**
 * @param {string} packed the file, compressed by gzip, in base64
 * @returns {Promise<WebAssembly.Module>}
 */
export async function unpacked(packed) {
  const gzip = Uint8Array.from(atob(packed), (character) => character.charCodeAt(0));
  const stream = new Blob([gzip]).stream().pipeThrough(new DecompressionStream("gzip"));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}
