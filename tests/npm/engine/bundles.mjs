// bundles.mjs WORK: the same page in bundles of Vite, webpack and esbuild, served by Vite while it
// is edited, and from another origin without a bundler. Chromium shows each, and each warps the
// picture and reports the SHA-256 of the file, which is that of the program's.

import { spawn } from "node:child_process";
import { createHash } from "node:crypto";
import { once } from "node:events";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join, resolve } from "node:path";
import { promisify } from "node:util";

const [, , work] = process.argv;
const tools = createRequire(`${process.env.NODE_PATH}/`);
const consumer = join(work, "consumer");
const { build: esbuild } = tools("esbuild");
const { build: vite, createServer: viteServer } = await import(
  join(process.env.NODE_PATH, "vite/dist/node/index.js")
);
const webpack = tools("webpack");

const sha = (bytes) => createHash("sha256").update(bytes).digest("hex");
const expected = sha(readFileSync(join(work, "expected/cat.png")));
const picture = readFileSync(join(work, "../../../images/chelsea.png"));
const warp = readFileSync(join(consumer, "cat.json"), "utf8");

/** @type {(text: string) => void} who waits for what a page reports */
let heard = () => {};
const listener = createServer((request, response) => {
  response.end();
  if (request.url.startsWith("/?")) heard(decodeURIComponent(request.url.slice(2)));
});
await new Promise((done) => listener.listen(0, "127.0.0.1", done));
const reports = `http://127.0.0.1:${listener.address().port}/?`;

// The page of each bundle: the picture is in it, so that nothing but the engine is fetched.
const script = (from, hasWorker) => `
import { Engine, WorkerEngine } from ${JSON.stringify(from)};
const picture = Uint8Array.from(atob(${JSON.stringify(picture.toString("base64"))}), (c) => c.charCodeAt(0));
try {
  const engine = await Engine.load();
  let file = engine.warpFile(picture, ${warp});
  if (${hasWorker}) {
    const worker = await WorkerEngine.spawn();
    const plan = await worker.plan([[20, 20]], { size: [64, 48] });
    const pose = await plan.pose([[25, 20]]);
    const image = new ImageData(new Uint8ClampedArray(64 * 48 * 4).fill(255), 64, 48);
    const { data } = await pose.warp(await worker.image(image));
    if (data[3] !== 0 || data[4 * 5 + 3] !== 255) throw new Error("the worker draws something else");
    const kept = await worker.image(image);
    const same = [0, 1].map((image) => ({ image, p: [[20, 20]] }));
    const mean = await worker.blend([image, kept], { images: same });
    if (mean.image.data.some((value) => value !== 255)) throw new Error("the worker blends something else");
    const refused = await worker.warpFile(picture, { p: [[1, 2]], q: 3 }).catch((error) => error);
    if (refused.code !== "bad_value" || refused.pointer !== "/q") throw refused;
    file = await worker.warpFile(picture, ${warp});
    const aborted = worker.warpFile(picture, ${warp}, { signal: AbortSignal.abort() });
    if ((await aborted.catch((error) => error)).name !== "AbortError") throw new Error("not aborted");
    worker.dispose();
  }
  const sum = new Uint8Array(await crypto.subtle.digest("SHA-256", file));
  report([...sum].map((byte) => byte.toString(16).padStart(2, "0")).join(""));
} catch (error) {
  report(error);
}
function report(text) {
  fetch(${JSON.stringify(reports)} + encodeURIComponent(text), { mode: "no-cors" });
}
`;
const page =
  '<!doctype html><meta charset="utf-8"><body><script type="module" src="./main.js"></script>';
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };

/** Serves a folder; other origins may read it. */
async function serve(folder) {
  const server = createServer((request, response) => {
    const path = join(folder, decodeURI(new URL(request.url, "http://host").pathname));
    try {
      const body = readFileSync(path.endsWith("/") ? `${path}index.html` : path);
      const type = TYPES[extname(path)] ?? (path.endsWith("/") ? "text/html" : "text/plain");
      response.writeHead(200, { "Content-Type": type, "Access-Control-Allow-Origin": "*" });
      response.end(body);
    } catch {
      response.writeHead(404).end();
    }
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  return [`http://127.0.0.1:${server.address().port}/`, () => server.close()];
}

/** A folder with the page and its script. */
function source(name, from) {
  const folder = join(consumer, name);
  mkdirSync(folder, { recursive: true });
  writeFileSync(join(folder, "index.html"), page);
  // One file has no worker beside it.
  writeFileSync(join(folder, "main.js"), script(from, !from.endsWith("inline")));
  return folder;
}

/** What the page reports, which Chromium shows. */
async function shown(address) {
  const report = new Promise((resolve) => (heard = resolve));
  // The browser itself: the script of its name in PATH would be ended without it.
  const browser = spawn("/usr/lib/chromium/chromium-headless-shell", [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    `--user-data-dir=${join(work, "chromium")}`,
    address,
  ]);
  const late = new Promise((resolve) =>
    setTimeout(resolve, 300_000, "nothing within five minutes"),
  );
  const text = await Promise.race([report, late]);
  const ended = once(browser, "exit");
  browser.kill();
  await ended;
  return text;
}

async function check(name, address) {
  const text = await shown(address);
  if (text !== expected) throw new Error(`${name}: ${text}`);
  console.log(`${name}: the same bytes`);
}

const quiet = { logLevel: "silent" };
{
  const folder = source("vite", "mlswarp/engine");
  await vite({ root: folder, build: { outDir: "dist", target: "esnext" }, ...quiet });
  const [address, close] = await serve(join(folder, "dist"));
  await check("Vite, built", address);
  close();
  const server = await viteServer({ root: folder, server: { host: "127.0.0.1" }, ...quiet });
  await server.listen();
  await check("Vite, while it is edited", server.resolvedUrls.local[0]);
  await server.close();
}
{
  const folder = source("webpack", "mlswarp/engine");
  const stats = await promisify(webpack)({
    mode: "production",
    context: folder,
    entry: "./main.js",
    experiments: { outputModule: true },
    // It warns of every file that is large.
    performance: false,
    output: { path: join(folder, "dist"), filename: "main.js", module: true },
  });
  if (stats.hasErrors() || stats.hasWarnings()) throw new Error(stats.toString("errors-warnings"));
  writeFileSync(join(folder, "dist/index.html"), page);
  const [address, close] = await serve(join(folder, "dist"));
  await check("webpack", address);
  close();
}
{
  const folder = source("esbuild", "mlswarp/engine/inline");
  await esbuild({
    entryPoints: [join(folder, "main.js")],
    outfile: join(folder, "dist/main.js"),
    bundle: true,
    format: "esm",
    minify: true,
    logLevel: "warning",
  });
  writeFileSync(join(folder, "dist/index.html"), page);
  const [address, close] = await serve(join(folder, "dist"));
  await check("esbuild, one file", address);
  close();
}
{
  const [package_, closePackage] = await serve(resolve(consumer, "node_modules/mlswarp"));
  const folder = source("origin", `${package_}engine/index.js`);
  const [address, close] = await serve(folder);
  await check("another origin, no bundler", address);
  close();
  closePackage();
}
process.exit();
