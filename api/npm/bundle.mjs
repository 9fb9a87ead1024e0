// Writes element/index.js: the element, the modules of the page that it is made of, and the client,
// in one file. For notebooks there is another with the engine, which is committed, so that who builds
// the package for Python needs no npm.
//
//     node bundle.mjs
//     node bundle.mjs --widget    writes api/python/python/mlswarp/_widget.js too
//     node bundle.mjs --check     says whether that is of these sources

import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { fileURLToPath } from "node:url";

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

// The widget has the engine in its file, and its worker as text.
const inside = {
  name: "inside",
  /** @param {import("esbuild").PluginBuild} build */
  setup(build) {
    const path = fileURLToPath(new URL("widget/engine.js", import.meta.url));
    build.onResolve({ filter: /^\.\.\/\.\.\/.*engine\/worker-engine\.js$/ }, () => ({ path }));
    const namespace = "bundled";
    build.onResolve({ filter: /^bundled:/ }, ({ path, resolveDir }) => ({
      path: resolve(resolveDir, path.slice(namespace.length + 1)),
      namespace,
    }));
    build.onLoad({ filter: /./, namespace }, async ({ path }) => ({
      contents: await bundle(path, []),
      loader: "text",
    }));
  },
};

/**
 * A module and what it imports as one text.
 *
 * @param {string} path
 * @param {import("esbuild").Plugin[]} plugins
 */
async function bundle(path, plugins) {
  const { outputFiles } = await build({
    entryPoints: [path],
    bundle: true,
    plugins,
    format: "esm",
    target: "es2022",
    minify: true,
    loader: { ".css": "text" },
    legalComments: "none",
    logLevel: "warning",
    write: false,
  });
  return outputFiles[0].text;
}

const here = (/** @type {string} */ name) => fileURLToPath(new URL(name, import.meta.url));
const element = here("../../src/web/element/element.js");
writeFileSync(here("element/index.js"), await bundle(element, [engine, outline]));

const [, , wish] = process.argv;
if (wish) {
  const origin = "// Made by `node api/npm/bundle.mjs --widget`, of api/npm/widget/widget.js.\n";
  const widget = origin + (await bundle(here("widget/widget.js"), [inside, outline]));
  const committed = here("../python/python/mlswarp/_widget.js");
  if (wish === "--widget") writeFileSync(committed, widget);
  else if (readFileSync(committed, "utf8") !== widget)
    throw new Error("_widget.js is not of these sources: node api/npm/bundle.mjs --widget");
}
