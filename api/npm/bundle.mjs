// Writes element/index.js: the element, the modules of the page that it is made of, and the client,
// in one file.
//
//     node bundle.mjs

import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const root = new URL("../../", import.meta.url);
/** esbuild: in `node_modules` here or above, or where a step of the tests has installed it. */
function esbuild() {
  const places = [".", "../../tests/artefacts/npm/", "../../tests/artefacts/npm-engine/"];
  for (const place of places) {
    try {
      return createRequire(new URL(place, import.meta.url))("esbuild");
    } catch {
      // Perhaps in the next one.
    }
  }
  throw new Error("esbuild is not installed: npm install --no-save esbuild");
}
const { build } = esbuild();

// Only who has no server loads the engine, so it is a file of its own.
const engine = {
  name: "engine",
  /** @param {import("esbuild").PluginBuild} build */
  setup(build) {
    const path = "../engine/worker-engine.js";
    build.onResolve({ filter: /engine\/worker-engine\.js$/ }, () => ({ path, external: true }));
  },
};

// The page names what lies beside the outline of a cut-out, and moves it inside; the element passes on
// what the server says.
const outline = {
  name: "outline",
  /** @param {import("esbuild").PluginBuild} build */
  setup(build) {
    const namespace = "outline";
    build.onResolve({ filter: /\/outline\.js$/ }, ({ path }) => ({ path, namespace }));
    build.onLoad({ filter: /./, namespace }, () => ({
      contents: "export const insideOf = () => null;",
    }));
  },
};

await build({
  entryPoints: [fileURLToPath(new URL("src/web/element/element.js", root))],
  outfile: fileURLToPath(new URL("element/index.js", import.meta.url)),
  bundle: true,
  plugins: [engine, outline],
  format: "esm",
  target: "es2022",
  minify: true,
  loader: { ".css": "text" },
  legalComments: "none",
  logLevel: "warning",
});
