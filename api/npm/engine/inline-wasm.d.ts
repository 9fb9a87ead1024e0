/** `mlswarp.wasm`, compressed, in base64. `pack.mjs` writes the module. */
declare const packed: string;
export default packed;
