// What the published package has beside its sources: the licences, the WebAssembly file as text,
// and the types. `npm pack` runs it.

import { execFileSync } from "node:child_process";
import { copyFileSync, readFileSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const here = (/** @type {string} */ name) => new URL(name, import.meta.url);
for (const licence of ["LICENSE-MIT", "LICENSE-APACHE"])
  copyFileSync(here(`../../${licence}`), here(licence));
const packed = gzipSync(readFileSync(here("mlswarp.wasm")), { level: 9 }).toString("base64");
writeFileSync(
  here("engine/inline-wasm.js"),
  `// mlswarp.wasm, compressed; made by pack.mjs.\n/** @type {string} */\nconst packed = ${JSON.stringify(packed)};\nexport default packed;\n`,
);
execFileSync(process.env.TSC ?? "tsc", ["--project", "."], {
  cwd: here("."),
  stdio: ["ignore", 2, 2],
});
