// <mls-warp> in Chromium, on a site of another origin, against the program.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync } from "node:fs";
import { after, before, describe, test } from "node:test";
import { gzipSync } from "node:zlib";

import { P, Q, ROOT, file, packaged, serve, until } from "./support.mjs";
import { launch, middle, ready, site, visit } from "./site.mjs";

const KEY = "a-key-of-the-tests-0123456789";
const pictures = `${ROOT}tests/artefacts/npm/pictures/`;
mkdirSync(pictures, { recursive: true });

/** A page with an element; what the site writes around it follows the pictures of the guide. */
const page = (attributes, more = "") => `<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>A site</title>
<meta name="viewport" content="width=device-width">
<script type="module" src="/npm/element/define.js"></script></head>
<body><main><h1>A site</h1>
<mls-warp src="/images/chelsea.png" aria-label="Cat" ${attributes}></mls-warp>${more}</main></body></html>`;
const handles = `handles='${JSON.stringify({ p: P })}'`;

const sha = (bytes) => createHash("sha256").update(bytes).digest("hex");

/** What is in the element, by its property or a function of it. */
const get = (where, read) =>
  where.evaluate(
    ([text]) => (0, eval)(`(${text})`)(document.querySelector("mls-warp")),
    [String(read)],
  );

async function drag(where, index, dx, dy, { steps = 8, release = true } = {}) {
  const [x, y] = await middle(where, index);
  await where.mouse.move(x, y);
  await where.mouse.down();
  await where.mouse.move(x + dx, y + dy, { steps });
  if (release) await where.mouse.up();
}

test("every entry is imported in bare Node, and the files are small", () => {
  for (const entry of ["client/index.js", "element/index.js", "element/define.js"]) {
    const code = `await import(${JSON.stringify(`${ROOT}api/npm/${entry}`)})`;
    const { status, stderr } = spawnSync("node", ["--input-type=module", "-e", code]);
    assert.equal(status, 0, `${entry}: ${stderr}`);
  }
  const size = (text) => gzipSync(text, { level: 9 }).length;
  const { outputFiles } = packaged("esbuild").buildSync({
    entryPoints: [`${ROOT}api/npm/client/index.js`],
    bundle: true,
    minify: true,
    format: "esm",
    write: false,
  });
  const sizes = {
    client: size(outputFiles[0].contents),
    element: size(readFileSync(`${ROOT}api/npm/element/index.js`)),
  };
  console.log(`# gzip -9: client ${sizes.client} B, element ${sizes.element} B`);
  assert.ok(sizes.client <= 8000 && sizes.element <= 45_000);
});

describe("in Chromium", () => {
  let server;
  let host;
  let browser;
  const opened = [];
  const visiting = async (path, options) => {
    const where = await visit(browser, `${host.address}${path}`, options);
    opened.push(where);
    return where;
  };
  before(async () => {
    host = await site();
    server = await serve({ options: ["--cors-origin", host.address, "--keys", `ann ${KEY}`] });
    // A server of its own for pages without a key.
    host.open = await serve({ options: ["--cors-origin", host.address] });
    host.pages["/"] = page(`server="${host.open.address}" ${handles}`);
    browser = await launch();
  });
  after(async () => {
    await browser.close();
    host.close();
    await Promise.all([server.stop(), host.open.stop()]);
  });

  test("a drag: preview, events, and the bytes of the server; a strict policy suffices", async () => {
    const at = host.open.address;
    host.headers["Content-Security-Policy"] =
      `default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; img-src blob:; ` +
      `connect-src 'self' ${at} ${at.replace("http", "ws")}; require-trusted-types-for 'script'`;
    const where = await visiting("/");
    delete host.headers["Content-Security-Policy"];
    await ready(where);
    await where.screenshot({ path: `${pictures}rest.png` });
    await drag(where, 2, 60, 40, { release: false });
    await where.waitForFunction(
      () =>
        document.querySelector("mls-warp").shadowRoot.getElementById("live").style.visibility ===
        "visible",
    );
    await where.screenshot({ path: `${pictures}dragging.png` });
    assert.equal(await get(where, (element) => element.state), "busy");
    await where.mouse.up();
    await ready(where);
    await where.screenshot({ path: `${pictures}dragged.png` });
    const [p, q, residual] = await get(where, ({ p, q, residual }) => [p, q, residual]);
    assert.deepEqual(p, P);
    assert.ok(q[2][0] > P[2][0] + 15 && q[0][0] === P[0][0], JSON.stringify(q));
    assert.ok(residual < 0.25);
    const heard = await where.evaluate(() => window.heard.map(({ type }) => type));
    assert.equal(heard[0], "warpready");
    assert.ok(heard.filter((type) => type === "warpinput").length > 2);
    assert.deepEqual(heard.slice(-1), ["warpchange"]);
    assert.equal(heard.filter((type) => type === "warpchange").length, 1);
    const bytes = await get(where, async (element) => [
      ...new Uint8Array(await (await element.toBlob()).arrayBuffer()),
    ]);
    const form = new FormData();
    form.set("image", new Blob([file("tests/images/chelsea.png")]));
    form.set("warp", JSON.stringify(await get(where, (element) => element.warp)));
    const direct = await fetch(`${at}/warp`, { method: "POST", body: form });
    assert.equal(sha(Buffer.from(bytes)), sha(Buffer.from(await direct.arrayBuffer())));
    const jpeg = await get(where, async (element) => {
      const blob = await element.toBlob("image/jpeg", { width: 90, quality: 0.7 });
      const { width } = await createImageBitmap(blob);
      return [blob.type, width];
    });
    assert.deepEqual(jpeg, ["image/jpeg", 90]);
    assert.deepEqual(where.errors, []);
  });

  test("by the keyboard alone", async () => {
    const where = await visiting("/");
    await ready(where);
    await where.keyboard.press("Tab");
    assert.equal(await get(where, (element) => element.shadowRoot.activeElement.id), "stage");
    await where.keyboard.press("Tab");
    assert.equal(await get(where, (element) => element.shadowRoot.activeElement.id), "handle-0");
    for (let k = 0; k < 3; k++) await where.keyboard.press("Shift+ArrowRight");
    assert.deepEqual(await get(where, (element) => element.q[0]), [P[0][0] + 30, P[0][1]]);
    assert.match(
      await get(where, (element) => element.shadowRoot.getElementById("says").textContent),
      /^Point 1 at 198, 112$/,
    );
    await ready(where);
    await where.screenshot({ path: `${pictures}keyboard.png` });
    await where.keyboard.press("Control+z");
    assert.deepEqual(await get(where, (element) => element.q[0]), P[0]);
    // A handle at the cross, then without it.
    await get(where, (element) => element.shadowRoot.getElementById("stage").focus());
    await where.keyboard.press("Escape");
    for (const key of ["ArrowUp", "ArrowUp", "Enter"]) await where.keyboard.press(key);
    assert.equal(await get(where, (element) => element.p.length), 4);
    await ready(where);
    await where.keyboard.press("Delete");
    assert.equal(await get(where, (element) => element.p.length), 3);
    await get(where, (element) => element.undo());
    assert.equal(await get(where, (element) => element.p.length), 4);
    await get(where, (element) => element.redo());
    await ready(where);
    // The host has the focus of what is in it; keys outside of it are the site's.
    await get(where, (element) => element.focusHandle(1));
    assert.equal(await where.evaluate(() => document.activeElement.localName), "mls-warp");
    await where.evaluate(() => document.activeElement.blur());
    const before = await get(where, (element) => JSON.stringify(element.q));
    await where.keyboard.press("Shift+ArrowRight");
    assert.equal(await get(where, (element) => JSON.stringify(element.q)), before);
    assert.deepEqual(where.errors, []);
  });

  test("by touch, on a phone: a drag with the magnifier, and a pinch", async () => {
    const where = await visiting("/", {
      viewport: { width: 390, height: 700 },
      hasTouch: true,
      isMobile: true,
      deviceScaleFactor: 2,
    });
    await ready(where);
    const wire = await where.context().newCDPSession(where);
    const touch = (type, ...places) =>
      wire.send("Input.dispatchTouchEvent", {
        type,
        touchPoints: places.map(([x, y], id) => ({ x, y, id })),
      });
    const [x, y] = await middle(where, 2);
    await touch("touchStart", [x, y]);
    for (let k = 1; k <= 6; k++) await touch("touchMove", [x + 4 * k, y + 3 * k]);
    await where.waitForTimeout(100);
    await where.screenshot({ path: `${pictures}phone.png` });
    assert.equal(
      await get(where, (element) => element.shadowRoot.getElementById("loupe").hidden),
      false,
    );
    await touch("touchEnd");
    await ready(where);
    assert.ok(await get(where, (element) => element.q[2][0] > 270));
    const zoom = (element) =>
      Number(
        /scale\((.*?)\)/.exec(element.shadowRoot.getElementById("picture").style.transform)[1],
      );
    const small = await get(where, zoom);
    const count = await get(where, (element) => element.p.length);
    await touch("touchStart", [150, y - 60], [180, y - 60]);
    for (let k = 1; k <= 5; k++)
      await touch("touchMove", [150 - 9 * k, y - 60], [180 + 9 * k, y - 60]);
    await touch("touchEnd");
    assert.ok((await get(where, zoom)) > 1.5 * small);
    assert.equal(await get(where, (element) => element.p.length), count);
    await get(where, (element) => element.zoomTo("fit"));
    assert.ok(Math.abs((await get(where, zoom)) - small) < 1e-6);
    assert.deepEqual(where.errors, []);
  });

  test("the server stops in mid-drag: the preview goes on, and the picture follows when it is back", async () => {
    let own = await serve({ options: ["--cors-origin", host.address] });
    host.pages["/stopped"] = page(`server="${own.address}" ${handles}`);
    const where = await visiting("/stopped");
    await ready(where);
    await drag(where, 2, 30, 10, { release: false });
    await own.stop();
    const [x, y] = await middle(where, 2);
    await where.mouse.move(x + 25, y + 20, { steps: 5 });
    const live = (element) => element.shadowRoot.getElementById("live").style.visibility;
    assert.equal(await get(where, live), "visible");
    const q = await get(where, (element) => element.q[2]);
    await where.mouse.up();
    await where.waitForFunction(() => window.heard.some(({ type }) => type === "warperror"));
    const error = await where.evaluate(() => window.heard.find(({ type }) => type === "warperror"));
    assert.deepEqual(error.detail, { name: "ConnectionFailed", code: "network" });
    assert.equal(await get(where, (element) => element.state), "error");
    // It has forgotten the session: the element has the file.
    own = await serve({ port: own.port, options: ["--cors-origin", host.address] });
    await ready(where);
    assert.deepEqual(await get(where, (element) => element.q[2]), q);
    await own.stop();
  });

  test("properties: before the class, in any order, and without events for what the site sets", async () => {
    const address = JSON.stringify(host.open.address);
    host.pages["/early"] = page(
      `server=${address}`,
      `<script>
        const early = document.querySelector("mls-warp");
        early.q = ${JSON.stringify(Q)};
        early.p = ${JSON.stringify(P)};
        early.tool = "line";
      </script>`,
    );
    const where = await visiting("/early");
    await ready(where);
    const { q, tool, warp } = await get(where, ({ q, tool, warp }) => ({ q, tool, warp }));
    assert.deepEqual([q, tool, warp.method], [Q, "line", "rigid"]);
    await get(where, (element) => {
      element.method = "affine";
      element.alpha = 1.5;
      element.strength = 0.5;
    });
    await ready(where);
    const half = await get(where, ({ warp, strength }) => ({ warp, strength }));
    assert.deepEqual(
      [half.warp.q, half.warp.method, half.warp.alpha, half.strength, half.warp.strength],
      [Q, "affine", 1.5, 0.5, 0.5],
    );
    await get(where, (element) => (element.warp = { p: [[10, 10]], method: "rigid" }));
    assert.deepEqual(await get(where, ({ p, q, strength }) => [p, q, strength]), [
      [[10, 10]],
      [[10, 10]],
      1,
    ]);
    await get(where, (element) => {
      element.p = [
        [10, 10],
        [
          [20, 20],
          [60, 20],
        ],
      ];
      element.q = [
        [12, 10],
        [
          [20, 24],
          [60, 24],
        ],
      ];
    });
    await ready(where);
    assert.deepEqual(await where.evaluate(() => window.heard.map(({ type }) => type)), [
      "warpready",
    ]);
    for (const [name, value] of [
      ["p", [[1]]],
      ["q", "x"],
      ["method", "thin"],
      ["tool", "lasso"],
      ["strength", Number.NaN],
    ]) {
      const thrown = await where.evaluate(
        ([name, value]) => {
          try {
            document.querySelector("mls-warp")[name] = value;
          } catch (error) {
            return error.name;
          }
        },
        [name, value],
      );
      assert.equal(thrown, "TypeError", name);
    }
    await get(where, (element) => (element.q = [[1, 1]]));
    await until(() => where.evaluate(() => window.heard.at(-1).type === "warperror"), "an error");
    // What a person does is told, and a site that hands it back changes nothing.
    await where.evaluate(() =>
      document.querySelector("mls-warp").addEventListener("warpchange", ({ target, detail }) => {
        target.p = detail.p;
        target.q = detail.q;
      }),
    );
    await drag(where, 0, 20, 12);
    await ready(where);
    const types = await where.evaluate(() => window.heard.map(({ type }) => type));
    assert.equal(types.filter((type) => type === "warpchange").length, 1);
    await get(where, (element) => element.undo());
    assert.deepEqual(await get(where, ({ q }) => q[0]), [12, 10]);
    // Wrong attributes are told, and do not throw.
    await get(where, (element) => element.setAttribute("handles", "{"));
    assert.equal(await where.evaluate(() => window.heard.at(-1).type), "warperror");
    await get(where, (element) => (element.readonly = true));
    const role = (element) => element.shadowRoot.getElementById("stage").getAttribute("role");
    assert.equal(await get(where, role), "img");
    assert.deepEqual(where.errors, []);
  });

  test("it is moved, adopted, removed, made often, and shows other pictures", async () => {
    const where = await visiting("/");
    await ready(where);
    await drag(where, 2, 20, 10);
    await ready(where);
    const q = await get(where, (element) => element.q);
    await where.evaluate(async () => {
      const element = document.querySelector("mls-warp");
      const aside = document.body.appendChild(document.createElement("aside"));
      element.stage = element.shadowRoot.getElementById("stage");
      aside.append(element);
      await null;
      if (aside.moveBefore) document.querySelector("main").moveBefore(element, null);
    });
    assert.ok(
      await get(where, (element) => element.stage === element.shadowRoot.getElementById("stage")),
    );
    await get(where, async (element) => {
      const main = element.parentNode;
      element.remove();
      await new Promise((resolve) => setTimeout(resolve, 50));
      main.append(element);
    });
    await ready(where);
    assert.deepEqual(await get(where, (element) => element.q), q);
    assert.deepEqual(await get(where, (element) => [...element.shadowRoot.children].length), 3);
    await get(where, (element) => element.undo());
    assert.deepEqual(await get(where, (element) => element.q), P);
    // Another document.
    await where.evaluate(async () => {
      const frame = document.body.appendChild(document.createElement("iframe"));
      const element = document.querySelector("mls-warp");
      frame.contentDocument.body.append(element);
      await new Promise((resolve) => setTimeout(resolve, 50));
      window.sheets = element.shadowRoot.adoptedStyleSheets.length;
      document.querySelector("main").append(element);
    });
    assert.equal(await where.evaluate(() => window.sheets), 2);
    await ready(where);
    // Pixels in place of a file, and pictures of other proportions.
    await get(where, (element) => {
      element.image = new ImageData(new Uint8ClampedArray(4 * 60 * 90).fill(200), 60, 90);
    });
    await until(
      () =>
        get(where, (element) => element.state === "ready" && element.image instanceof ImageData),
      "the pixels",
    );
    const [wide, high] = await get(where, (element) => {
      const { width, height } = element.getBoundingClientRect();
      return [width, height];
    });
    assert.ok(Math.abs(high / wide - 1.5) < 0.02, `${wide} x ${high}`);
    await get(where, (element) => (element.image = "/images/none.png"));
    await until(() => where.evaluate(() => window.heard.at(-1).type === "warperror"), "an error");
    // Browsers have few contexts of WebGL: those of elements that have left are given back.
    where.errors.length = 0;
    await where.evaluate(async () => {
      for (let k = 0; k < 40; k++) {
        const element = document.createElement("mls-warp");
        element.server = document.querySelector("mls-warp").server;
        element.src = "/images/chelsea.png";
        document.body.append(element);
        await new Promise((resolve) => setTimeout(resolve, 20));
        element.remove();
        await null;
      }
    });
    assert.deepEqual(where.errors, []);
  });

  test("a session token, which is asked for again, and a session that exists", async () => {
    const session = crypto.randomUUID();
    const minted = async (ops, ttl) => {
      const answer = await fetch(`${server.address}/sessions/${session}/tokens`, {
        method: "POST",
        headers: { Authorization: `Bearer ${KEY}`, "Content-Type": "application/json" },
        body: JSON.stringify({ ops, ttl }),
      });
      return (await answer.json()).token;
    };
    const token = await minted(["upload", "handles", "warp", "drag"], 600);
    host.pages["/token"] = token;
    host.pages["/with-token"] = page(
      `session="${session}" ${handles}`,
      `<script type="module">
        import { Client } from "/npm/client/index.js";
        window.asked = 0;
        const auth = async () => {
          window.asked += 1;
          return (await fetch("/token")).text();
        };
        const client = new Client({ server: ${JSON.stringify(server.address)}, auth });
        document.querySelector("mls-warp").client = client;
      </script>`,
    );
    const where = await visiting("/with-token");
    await ready(where);
    await drag(where, 2, 20, 10);
    await ready(where);
    assert.equal(await where.evaluate(() => window.asked), 1);
    // Another page shows the same session, without the file.
    host.pages["/token"] = await minted(["read", "warp"], 600);
    host.pages["/attached"] = host.pages["/with-token"]
      .replace('src="/images/chelsea.png"', "")
      .replace(handles, "");
    const other = await visiting("/attached");
    await ready(other);
    assert.deepEqual(await get(other, (element) => element.p), P);
    await drag(other, 1, 15, 10);
    await ready(other);
    await other.screenshot({ path: `${pictures}attached.png` });
    host.pages["/token"] = "no-token-of-this-server";
    const refused = await visiting("/with-token");
    await until(() => refused.evaluate(() => window.heard.length), "an error");
    assert.equal(await refused.evaluate(() => window.heard[0].detail.code), "forbidden");
    assert.deepEqual([...where.errors, ...other.errors], []);
  });

  test("no coefficients, no WebGL", async () => {
    const where = await visiting("/");
    await where.route("**/plan?*", (route) => route.abort());
    await where.reload();
    await ready(where);
    await drag(where, 2, 30, 20, { steps: 20, release: false });
    const live = (element) => element.shadowRoot.getElementById("live").style.visibility;
    await until(async () => (await get(where, live)) === "visible", "a frame of the socket");
    await where.mouse.up();
    await ready(where);
    const plain = await visiting("/");
    await plain.addInitScript(() => {
      const getContext = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
      };
    });
    await plain.reload();
    await ready(plain);
    await drag(plain, 2, 30, 20, { steps: 20, release: false });
    await until(async () => (await get(plain, live)) === "visible", "a frame of the server");
    await plain.mouse.up();
    await ready(plain);
    assert.deepEqual(plain.errors, []);
  });

  test("without a server: the engine in a worker, under a strict policy, and the same bytes", async () => {
    host.headers["Content-Security-Policy"] =
      `default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; img-src blob:; connect-src 'self'`;
    host.pages["/alone"] = page(handles);
    const where = await visiting("/alone");
    await ready(where);
    await drag(where, 2, 60, 40, { release: false });
    const live = (element) => element.shadowRoot.getElementById("live").style.visibility;
    await until(async () => (await get(where, live)) === "visible", "a preview");
    await where.mouse.up();
    await ready(where);
    delete host.headers["Content-Security-Policy"];
    await where.screenshot({ path: `${pictures}alone.png` });
    // A handle where the picture was posed: its place at rest is another one.
    const [x, y] = await middle(where, 2);
    await where.mouse.click(x - 80, y - 30);
    await ready(where);
    const { warp, residual } = await get(where, ({ warp, residual }) => ({ warp, residual }));
    assert.equal(warp.p.length, 4);
    assert.ok(Math.hypot(warp.p[3][0] - warp.q[3][0], warp.p[3][1] - warp.q[3][1]) > 5);
    assert.ok(residual < 0.25, `${residual}`);
    const asByServer = async (warp) => {
      const bytes = await get(where, async (element) => [
        ...new Uint8Array(await (await element.toBlob()).arrayBuffer()),
      ]);
      const form = new FormData();
      form.set("image", new Blob([file("tests/images/chelsea.png")]));
      form.set("warp", JSON.stringify(warp));
      const direct = await fetch(`${host.open.address}/warp`, { method: "POST", body: form });
      assert.equal(sha(Buffer.from(bytes)), sha(Buffer.from(await direct.arrayBuffer())));
      return direct.headers.get("Warp-Folds");
    };
    await asByServer(warp);
    // A fold is removed as by the service.
    const corners = [
      [20, 20],
      [430, 20],
      [20, 280],
      [430, 280],
    ];
    const pulled = { p: [...corners, [100, 150]], q: [...corners, [330, 150]], folds: "remove" };
    await where.evaluate((warp) => (document.querySelector("mls-warp").warp = warp), pulled);
    await ready(where);
    const removed = await get(where, (element) => element.warp);
    assert.equal(removed.folds, "remove");
    assert.equal(await asByServer(removed), "0");
    // What follows the outline of the picture has its grid from the engine, too.
    const puppet = { p: pulled.p, q: [...corners, [130, 140]], method: "arap" };
    await where.evaluate((warp) => (document.querySelector("mls-warp").warp = warp), puppet);
    await ready(where);
    assert.ok((await get(where, (element) => element.residual)) < 0.5);
    await asByServer(puppet);
    await assert.rejects(asByServer({ ...removed, folds: "report" }), assert.AssertionError);
    // What the engine refuses names the handles.
    await get(
      where,
      (element) =>
        (element.warp = {
          p: [
            [9, 9],
            [
              [5, 5],
              [5, 5],
            ],
          ],
        }),
    );
    await until(() => where.evaluate(() => window.heard.at(-1).type === "warperror"), "an error");
    assert.equal(await where.evaluate(() => window.heard.at(-1).detail.code), "degenerate_line");
    await get(
      where,
      (element) =>
        (element.warp = {
          p: [
            [9, 9],
            [
              [5, 5],
              [50, 5],
            ],
          ],
        }),
    );
    await ready(where);
    assert.deepEqual(where.errors, []);
  });

  test("axe finds nothing; styles from outside", async () => {
    host.pages["/styled"] = page(
      `server="${host.open.address}" ${handles}`,
      `<style>
        mls-warp { --mls-accent: #d4550f; --mls-handle-size: 22px; max-width: 500px }
        mls-warp::part(ring) { stroke: #ff0 }
      </style>`,
    );
    for (const [path, options] of [
      ["/", {}],
      ["/styled", { colorScheme: "dark" }],
    ]) {
      const where = await visiting(path, options);
      await ready(where);
      await where.mouse.click(...(await middle(where, 1)));
      await where.screenshot({ path: `${pictures}${path === "/" ? "selected" : "styled"}.png` });
      await where.evaluate(packaged("axe-core").source);
      const { violations } = await where.evaluate(() => window.axe.run());
      assert.deepEqual(
        violations.map(({ id, nodes }) => [id, nodes[0].html]),
        [],
      );
    }
    const { declarations } = JSON.parse(file("api/npm/custom-elements.json")).modules[0];
    const { attributes, members, events } = declarations[0];
    const [where] = opened;
    const real = await get(where, ({ constructor }) => ({
      attributes: constructor.observedAttributes,
      members: Object.getOwnPropertyNames(constructor.prototype).filter(
        (name) => name !== "constructor" && !name.endsWith("Callback"),
      ),
    }));
    const names = (list) => list.map(({ name }) => name).sort();
    assert.deepEqual(names(attributes), real.attributes.sort());
    assert.deepEqual(names(members), real.members.sort());
    const types = file("api/npm/element/index.d.ts").toString();
    for (const { name } of [...members, ...events])
      assert.match(types, new RegExp(`\\b${name}\\b`));
  });
});
