/** `mlswarp.wasm`, compressed, in base64: mlswarp/widget.py writes it in front of the module. */
declare const MLSWARP_WASM: string;

/** A module with what it imports, as text. */
declare module "bundled:*" {
  const text: string;
  export default text;
}
