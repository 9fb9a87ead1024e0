// Writes element/index.js: the element, the modules of the page that it is made of, and the client,
// in one file.
//
//     node bundle.mjs

import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const root = new URL("../../", import.meta.url);
// esbuild is where tests/npm/run installs it, or in node_modules here.
const installed = createRequire(new URL("tests/artefacts/npm/", root));
const { build } = await import(installed.resolve("esbuild"));

await build({
  entryPoints: [fileURLToPath(new URL("src/web/element/element.js", root))],
  outfile: fileURLToPath(new URL("element/index.js", import.meta.url)),
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  loader: { ".css": "text" },
  legalComments: "none",
  logLevel: "warning",
});
