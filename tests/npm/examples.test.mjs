// The examples of api/examples for sites, as they stand there.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { cpSync, rmSync } from "node:fs";
import { after, before, describe, test } from "node:test";

import { P, ROOT, file, serve, until } from "./support.mjs";
import { launch, middle, ready, site, visit } from "./site.mjs";

const KEY = "a-key-of-the-tests-0123456789";
const kept = `${ROOT}tests/artefacts/npm/`;

describe("the examples", () => {
  let browser;
  before(async () => {
    browser = await launch();
  });
  after(() => browser.close());

  /** A site with the package as a bundler-less page has it, and with the cat. */
  const siteOf = (pages) =>
    site(
      { "/cat.jpg": file("src/web/cat.jpg"), ...pages },
      { "/node_modules/mlswarp/": `${kept}node_modules/mlswarp/` },
    );

  async function dragged(where) {
    await ready(where);
    const [x, y] = await middle(where, 2);
    await where.mouse.move(x, y);
    await where.mouse.down();
    await where.mouse.move(x + 40, y + 25, { steps: 6 });
    await where.mouse.up();
    await ready(where);
    return where.evaluate(() => document.querySelector("mls-warp").q);
  }

  test("the guide shows embed.html as it is", () => {
    const guide = file("src/web/docs/index.html").toString();
    const [, shown] = /<pre id="site-embed"[^>]*>\n?(.*?)<\/pre>/s.exec(guide);
    const text = shown.replaceAll("&lt;", "<").replaceAll("&gt;", ">").replaceAll("&amp;", "&");
    assert.equal(text.trim(), file("api/examples/embed.html").toString().trim());
  });

  test("embed.html: a session token, a drag, a file", async () => {
    const host = await siteOf({ "/": file("api/examples/embed.html") });
    const server = await serve({
      options: ["--cors-origin", host.address, "--keys", `ann ${KEY}`],
    });
    const session = crypto.randomUUID();
    const minted = await fetch(`${server.address}/sessions/${session}/tokens`, {
      method: "POST",
      headers: { Authorization: `Bearer ${KEY}`, "Content-Type": "application/json" },
      body: JSON.stringify({
        ops: ["read", "upload", "handles", "warp", "drag"],
        max_bytes: 8 << 20,
      }),
    });
    const token = { server: server.address, session, ...(await minted.json()) };
    host.pages["/token"] = JSON.stringify(token);
    const where = await visit(browser, host.address);
    const q = await dragged(where);
    assert.ok(q[2][0] > P[2][0] + 10);
    assert.equal(await where.locator("output").textContent(), JSON.stringify(q));
    const [download] = await Promise.all([
      where.waitForEvent("download"),
      where.getByRole("button", { name: "Save" }).click(),
    ]);
    assert.equal(download.suggestedFilename(), "cat.jpg");
    assert.deepEqual(where.errors, []);
    host.close();
    await server.stop();
  });

  test("drag.html: frames of the server follow the pointer, without a bundler", async () => {
    const host = await siteOf({ "/": file("api/examples/drag.html") });
    const server = await serve({ options: ["--cors-origin", host.address] });
    const where = await visit(browser, `${host.address}/?server=${server.address}`);
    await where.setInputFiles("input", `${ROOT}src/web/cat.jpg`);
    const pixels = () =>
      where.evaluate(() => {
        const canvas = document.querySelector("canvas");
        return canvas.toDataURL().slice(-2000) + canvas.width;
      });
    await until(async () => (await pixels()).length > 1000, "the first frame");
    const first = await pixels();
    const { x, y, width, height } = await where.locator("canvas").boundingBox();
    await where.mouse.move(x + width / 2, y + height / 2);
    await where.mouse.move(x + 0.6 * width, y + 0.6 * height, { steps: 10 });
    await until(async () => (await pixels()) !== first, "another picture");
    assert.equal(await where.locator("output").textContent(), "open");
    assert.deepEqual(where.errors, []);
    host.close();
    await server.stop();
  });

  test("React 19 in Vite: types, a build, properties and events", async () => {
    // Below the node modules of the tests.
    const folder = `${kept}vite`;
    rmSync(folder, { recursive: true, force: true });
    cpSync(`${ROOT}api/examples/vite`, folder, { recursive: true });
    const tool = (name, ...options) => {
      const run = spawnSync(`${kept}node_modules/.bin/${name}`, options, {
        cwd: folder,
        encoding: "utf8",
      });
      assert.equal(run.status, 0, run.stdout + run.stderr);
    };
    tool("tsc", "--project", ".");
    tool("vite", "build", "--logLevel", "error");
    const host = await site(
      { "/cat.jpg": file("src/web/cat.jpg") },
      { "/assets/": `${folder}/dist/assets/` },
    );
    host.pages["/"] = file("tests/artefacts/npm/vite/dist/index.html");
    const server = await serve({ options: ["--cors-origin", host.address] });
    const where = await visit(browser, `${host.address}/?server=${server.address}`);
    const q = await dragged(where);
    assert.ok(q[2][0] > P[2][0] + 10);
    assert.equal(await where.locator("output").textContent(), JSON.stringify(q));
    await where.getByRole("button", { name: "Put back" }).click();
    await ready(where);
    assert.deepEqual(await where.evaluate(() => document.querySelector("mls-warp").q), P);
    // Without a server: Vite has taken the worker and the WebAssembly file along.
    const alone = await visit(browser, host.address);
    const moved = await dragged(alone);
    assert.ok(moved[2][0] > P[2][0] + 10);
    assert.deepEqual(alone.errors, []);
    assert.deepEqual(where.errors, []);
    host.close();
    await server.stop();
  });
});
