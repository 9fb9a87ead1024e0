// Of which sources a WebAssembly file was made.

import { readFileSync } from "node:fs";

const module = await WebAssembly.compile(readFileSync(process.argv[2]));
console.log(new TextDecoder().decode(WebAssembly.Module.customSections(module, "mlswarp")[0]));
