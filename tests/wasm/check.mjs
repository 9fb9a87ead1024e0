// Loads a WebAssembly file that imports nothing, and has it compare every method's result with the one it should be.

import { readFile } from "node:fs/promises";

const { instance } = await WebAssembly.instantiate(await readFile(process.argv[2]), {});
const METHODS = 5;
let failures = 0;
for (let method = 0; method < METHODS; method++) {
  const difference = instance.exports.difference(method) >>> 0;
  if (difference !== 0) {
    console.log(`method ${method}: the sum differs by ${difference}`);
    failures++;
  }
}
process.exit(failures === 0 ? 0 : 1);
