// The example as `next start` serves it.

import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { readFileSync, writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { createInterface } from "node:readline";
import { test } from "node:test";

import { launch, middle, ready, visit } from "../site.mjs";
import { P, ROOT } from "../support.mjs";

const kept = `${ROOT}tests/artefacts/npm-next/`;

async function start() {
  const next = spawn("node_modules/next/dist/bin/next", ["start", "-H", "127.0.0.1", "-p", "0"], {
    cwd: kept,
    stdio: ["ignore", "pipe", "inherit"],
  });
  for await (const line of createInterface({ input: next.stdout })) {
    const found = /http:\/\/127\.0\.0\.1:\d+/.exec(line);
    if (found) return { address: found[0], next };
  }
  throw new Error("Next.js does not start");
}

test("Next.js: a drag in the browser, and the file that Node draws", async () => {
  const [{ address, next }, browser] = await Promise.all([start(), launch()]);
  try {
    const where = await visit(browser, address);
    await ready(where);
    const [x, y] = await middle(where, 2);
    await where.mouse.move(x, y);
    await where.mouse.down();
    await where.mouse.move(x + 40, y + 25, { steps: 6 });
    await where.mouse.up();
    await ready(where);
    const q = await where.evaluate(() => document.querySelector("mls-warp").q);
    assert.ok(q[2][0] > P[2][0] + 10);
    assert.equal(await where.locator("output").textContent(), JSON.stringify(q));

    const [download] = await Promise.all([
      where.waitForEvent("download"),
      where.getByRole("button", { name: "Save" }).click(),
    ]);
    writeFileSync(`${kept}warp.json`, JSON.stringify({ p: P, q, output: { format: "png" } }));
    const drawn = spawnSync(
      resolve(process.env.MLSWARP_PROGRAM),
      ["warp", "public/cat.jpg", "warp.json", "-o", "expected.png"],
      { cwd: kept, encoding: "utf8" },
    );
    assert.equal(drawn.status, 0, drawn.stderr);
    assert.deepEqual(readFileSync(await download.path()), readFileSync(`${kept}expected.png`));
    assert.deepEqual(where.errors, []);

    const refused = await fetch(`${address}/warp`, { method: "POST", body: '{"q":[[1,2]]}' });
    assert.equal(refused.status, 400);
    assert.match(await refused.text(), /q/);
  } finally {
    await browser.close();
    next.kill();
    await once(next, "exit");
  }
});
