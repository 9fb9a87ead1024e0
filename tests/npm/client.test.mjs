// The client against the program, a way to it that is cut, and servers that answer by a script.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { after, before, describe, test } from "node:test";
import { setTimeout as pause } from "node:timers/promises";

import { ApiError, Client, ConnectionFailed } from "../../api/npm/client/index.js";
import {
  CAT,
  P,
  Q,
  answer,
  cuttable,
  packaged,
  problem,
  scripted,
  serve,
  until,
} from "./support.mjs";

const { WebSocket, WebSocketServer } = packaged("ws");

const sha = async (blob) =>
  createHash("sha256")
    .update(Buffer.from(await blob.arrayBuffer()))
    .digest("hex");

const unhandled = [];
process.on("unhandledRejection", (error) => unhandled.push(error));
after(async () => {
  await pause(50);
  assert.deepEqual(unhandled, []);
});

describe("against the program", () => {
  let server;
  let client;
  before(async () => {
    server = await serve();
    client = new Client({ server: server.address, WebSocket });
  });
  after(() => server.stop());

  test("a file is warped to the bytes that the server makes, by a session too", async () => {
    const form = new FormData();
    form.set("image", new Blob([CAT]));
    form.set("warp", JSON.stringify({ p: P, q: Q }));
    const raw = await fetch(`${server.address}/warp`, { method: "POST", body: form });
    const expected = await sha(await raw.blob());
    const once = await client.warp(CAT, { p: P, q: Q });
    assert.equal(await sha(once.blob), expected);
    assert.equal(once.blob.type, "image/png");
    assert.equal(once.folds, 0);
    assert.ok(once.residual < 0.25);
    assert.ok(once.timing.deform > 0, JSON.stringify(once.timing));
    assert.deepEqual(once.warnings, []);
    const session = await client.open(CAT, { p: P });
    const drawn = await session.warp(Q);
    assert.equal(await sha(drawn.blob), expected);
    assert.ok(drawn.etag && drawn.requestId);
    const small = await session.warp({ q: Q, strength: 0.5 }, { output: { width: 100 } });
    assert.ok(small.blob.size < drawn.blob.size);
    const fitted = await session.warp(Q, {
      output: { canvas: { x: -5, y: 0, width: 20, height: 9 } },
    });
    assert.deepEqual(fitted.canvas, { x: -5, y: 0, width: 20, height: 9 });
    const jpeg = await session.warp(Q, { accept: "image/jpeg" });
    assert.equal(jpeg.blob.type, "image/jpeg");
    await session.delete();
    await session.delete();
  });

  test("what else a session answers", async (t) => {
    const session = await client.open(new Blob([CAT]), { p: P });
    t.after(() => session[Symbol.asyncDispose]());
    assert.equal(session.object.image.width, 451);
    const mesh = await session.mesh(Q);
    assert.equal(mesh.xy.length, 2 * mesh.columns * mesh.rows);
    const { points } = await session.points({ q: Q, points: P });
    for (const [k, [x, y]] of points.entries())
      assert.ok(Math.hypot(x - Q[k][0], y - Q[k][1]) < 1e-6);
    const map = await session.map({ q: Q, width: 50 });
    assert.equal(await map.blob.slice(1, 6).text(), "NUMPY");
    assert.ok((await session.report(Q)).residuals.every((px) => px < 0.25));
    const plan = await session.plan({ columns: 9, rows: 7, precision: "f16" });
    assert.equal(new DataView(plan).getUint32(16, true), 9);
    await session.putHandles({ p: [...P, [20, 20]] });
    assert.equal(session.object.p.length, 4);
    const fit = await session.fit([...Q, [20, 20]]);
    assert.ok(fit.candidates.length > 1);
    await session.putLayer("depth", CAT);
    assert.equal((await session.layer("depth")).size, CAT.length);
    const layer = await session.warp({ q: [...Q, [20, 20]], layer: "depth" });
    assert.equal(layer.blob.type, "image/png");
    await session.deleteLayer("depth");
    await assert.rejects(session.layer("depth"), { code: "no_such_layer", status: 404 });
    const other = client.session(session.id);
    assert.equal((await other.refresh()).p.length, 4);
  });

  test("what needs no session", async () => {
    const extent = [451, 300];
    const mapped = await client.points({ extent, p: P, q: Q, points: [[240, 250]], boxes: [] });
    assert.equal(mapped.points.length, 1);
    // What the service hands back unread is written as in any JSON; what it reads is not.
    const feature = (score, x) => ({
      type: "Feature",
      properties: { score },
      geometry: { type: "Point", coordinates: [x, 5] },
    });
    const { geojson } = await client.points({ extent, p: P, q: Q, geojson: feature(NaN, 5) });
    assert.equal(geojson.properties.score, null);
    const no = await client
      .points({ extent, p: P, q: Q, geojson: feature(1, NaN) })
      .catch((error) => error);
    assert.match(no.pointer, /^\/geojson\/geometry\/coordinates/);
    const both = { extent, p: P, q: Q, strength: NaN, geojson: feature(NaN, 5) };
    assert.equal((await client.points(both).catch((error) => error)).pointer, "/strength");
    const map = await client.map({ extent, p: P, q: Q, width: 40 }, { accept: "image/tiff" });
    assert.equal(map.blob.type, "image/tiff");
    const warped = { extent, p: P, q: Q };
    assert.ok((await client.report(warped)).residuals.every((px) => px < 0.25));
    const pins = [...P, [20, 20], [400, 280]];
    assert.ok((await client.fit({ extent, p: pins, q: pins })).best.method);
    const read = await client.landmarks(new Blob(["x,y\n120,60\n200,160\n"]));
    assert.equal(read.p.length, 2);
    const [p, q] = ["x,y\n120,60\n200,160\n", "x,y\n130,60\n200,170\n"].map(
      (text) => new Blob([text]),
    );
    assert.deepEqual((await client.landmarks({ p, q })).q[0], [130, 60]);
    const blend = await client.blend(
      [CAT, CAT],
      { images: [{ image: 0 }, { image: 1 }] },
      { landmarks: [p, q] },
    );
    assert.equal(blend.blob.type, "image/png");
  });

  test("a problem names what was wrong", async () => {
    const error = await client.warp(CAT, { p: P, q: Q.slice(1) }).catch((error) => error);
    assert.ok(error instanceof ApiError);
    assert.deepEqual([error.status, error.code], [422, "shape_mismatch"]);
    assert.ok(error.message.length > 10 && error.requestId);
    const wrong = await client.warp(CAT, { p: P, q: [...Q.slice(1), [1, 2, 3]] }).catch((e) => e);
    assert.match(wrong.pointer, /^\/q/);
    for (const [given, pointer] of [
      [{ q: Q, strength: Number.NaN }, "/strength"],
      [{ q: [...Q.slice(1), [1, -Infinity]] }, `/q/${Q.length - 1}/1`],
    ]) {
      const no = await client.warp(CAT, { p: P, ...given }).catch((error) => error);
      assert.deepEqual([no.code, no.pointer], ["not_finite", pointer]);
      const asked = await client.report({ p: P, ...given }).catch((error) => error);
      assert.deepEqual([asked.code, asked.pointer], ["not_finite", pointer]);
    }
  });

  test("a batch is a stream, and can be left", async (t) => {
    const session = await client.open(CAT, { p: P });
    t.after(() => session[Symbol.asyncDispose]());
    const small = { output: { width: 40 } };
    const batch = await session.batch({ q: Q, steps: 5, ...small });
    const bytes = new Uint8Array(await batch.arrayBuffer());
    assert.equal(String.fromCharCode(...bytes.subarray(0, 2)), "PK");
    const gif = await session.batch({ q: Q, steps: 3, ...small }, { accept: "image/gif" });
    assert.equal(gif.headers.get("Content-Type"), "image/gif");
    await gif.body.cancel();
    const leaving = new AbortController();
    const long = await session.batch({ q: Q, steps: 400 }, { signal: leaving.signal });
    const reader = long.body.getReader();
    assert.ok((await reader.read()).value.length > 0);
    leaving.abort(new Error("enough"));
    await assert.rejects(async () => {
      while (!(await reader.read()).done);
    });
  });

  test("a signal ends what runs, with its reason", async (t) => {
    const gone = AbortSignal.abort(new Error("before"));
    await assert.rejects(client.open(CAT, { p: P }, { signal: gone }), /before/);
    const during = new AbortController();
    const warp = client.warp(CAT, { p: P, q: Q }, { signal: during.signal });
    setTimeout(() => during.abort(new Error("during")), 5);
    await assert.rejects(warp, /during/);
    const session = await client.open(CAT, { p: P });
    t.after(() => session[Symbol.asyncDispose]());
    const drags = new AbortController();
    const drag = session.drag({ signal: drags.signal });
    drag.pose(Q);
    await until(() => drag.state === "open", "open");
    // Nobody waits for its frames: nothing is rejected.
    drags.abort(new Error("dragged"));
    assert.equal(drag.state, "closed");
    const read = session.drag({ signal: AbortSignal.timeout(300), frames: "mesh" });
    await assert.rejects(async () => {
      for await (const _ of read);
    }, /timeout/);
    const closed = session.drag({ signal: gone });
    assert.equal(closed.state, "closed");
  });

  test("an expired session is uploaded again, with its layers, if it was opened so", async () => {
    const session = await client.open(CAT, { p: P }, { reopen: true });
    await session.putLayer("depth", CAT);
    await client.session(session.id).delete();
    const [a, b] = await Promise.all([session.warp(Q), session.warp({ q: Q, layer: "depth" })]);
    assert.ok(a.blob.size && b.blob.size);
    const other = await client.open(CAT, { p: P });
    await client.session(other.id).delete();
    await assert.rejects(other.warp(Q), { status: 404, code: "no_such_session" });
    await session.delete();
  });

  test("a drag: the newest pose wins, iteration acknowledges, the last frame is full", async (t) => {
    const session = await client.open(CAT, { p: P });
    t.after(() => session[Symbol.asyncDispose]());
    const drag = session.drag({ frames: "png" });
    const states = [];
    drag.addEventListener("state", () => states.push(drag.state));
    let last = 0;
    for (let k = 0; k < 60; k++) last = drag.pose(Q.map(([x, y]) => [x - 1 + k / 60, y]));
    last = drag.pose(Q);
    let frames = 0;
    let full;
    for await (const frame of drag) {
      frames += 1;
      if (frame.pose === last && frame.full) {
        full = frame;
        break;
      }
    }
    assert.ok(frames < 30, `${frames} frames`);
    assert.equal(await sha(full.blob), await sha((await session.warp(Q)).blob));
    assert.equal(full.blob.type, "image/png");
    assert.deepEqual(states, ["open", "closed"]);
  });

  test("a drag of meshes, by events; a wrong pose is a problem and no end", async (t) => {
    const session = await client.open(CAT, { p: P });
    t.after(() => session[Symbol.asyncDispose]());
    for (const compact of [false, true]) {
      const drag = session.drag({ frames: "mesh", compact });
      const problems = [];
      drag.addEventListener("problem", ({ error }) => problems.push(error.code));
      const frames = [];
      drag.addEventListener("frame", ({ frame }) => frames.push(frame));
      drag.pose(Q.slice(1));
      await until(() => problems.length, "a problem");
      drag.pose(Q, { strength: Number.NaN });
      await until(() => problems.length > 1, "another problem");
      assert.deepEqual(problems, ["shape_mismatch", "not_finite"]);
      for (let k = 1; k <= 5; k++) {
        const pose = drag.pose(Q, { strength: k / 5 });
        await until(() => frames.some((frame) => frame.pose === pose), "a frame");
      }
      const { mesh, report } = frames.at(-1);
      assert.equal(mesh.xy.length, 2 * mesh.columns * mesh.rows);
      assert.equal(report.folds, 0);
      const exact = await session.mesh(Q);
      if (!compact) assert.deepEqual(mesh.xy, exact.xy);
      else assert.ok(Math.abs(mesh.xy[0] - exact.xy[0]) < 0.01);
      drag[Symbol.dispose]();
    }
  });

  test("a drag whose session ends says so", async () => {
    const session = await client.open(CAT, { p: P });
    const drag = session.drag({ frames: "mesh" });
    drag.pose(Q);
    await assert.rejects(
      async () => {
        for await (const _ of drag) {
          await client.session(session.id).delete();
          drag.pose(P);
        }
      },
      { code: "no_such_session" },
    );
    const never = client.session("00000000-0000-4000-8000-000000000000").drag();
    await until(() => never.state === "closed", "closed");
    assert.equal(never.error.code, "no_such_session");
  });
});

describe("connections that break", () => {
  test("a cut and a refused connection in mid-drag", async () => {
    const server = await serve();
    const way = await cuttable(server.port);
    const client = new Client({ server: way.address, WebSocket });
    const session = await client.open(CAT, { p: P });
    const drag = session.drag({ frames: "mesh" });
    const states = [];
    drag.addEventListener("state", () => states.push(drag.state));
    const shown = [];
    const loop = (async () => {
      for await (const frame of drag) shown.push(frame.pose);
    })();
    const first = drag.pose(P);
    await until(() => shown.includes(first), "a frame");
    for (let k = 0; k < 3; k++) {
      way.refuses = k === 1;
      way.cut();
      // It may be open again already.
      await until(() => states.filter((s) => s === "reconnecting").length > k, "reconnecting");
      const pose = drag.pose(Q);
      if (way.refuses) await pause(500);
      way.refuses = false;
      await until(() => shown.includes(pose), "a frame after the cut");
    }
    const resent = drag.pose(P);
    await until(() => shown.includes(resent), "a frame");
    drag.close();
    await loop;
    const expected = ["open", ...Array(3).fill(["reconnecting", "open"]).flat(), "closed"];
    assert.deepEqual(states, expected);
    // A request that a cut interrupts is sent again.
    const opened = way.opened;
    const warp = session.warp(Q);
    way.cut();
    assert.ok((await warp).blob.size);
    assert.ok(way.opened > opened);
    way.refuses = true;
    way.cut();
    const impatient = client.with({ maxRetries: 0 });
    await assert.rejects(impatient.session(session.id).warp(Q), (error) => {
      assert.ok(error instanceof ConnectionFailed);
      return error.code === "network";
    });
    way.close();
    await server.stop();
  });

  test("the server restarts in mid-drag, and has forgotten the session", async () => {
    let server = await serve();
    const { port } = server;
    const client = new Client({ server: server.address, WebSocket });
    const session = await client.open(CAT, { p: P }, { reopen: true });
    const drag = session.drag({ frames: "mesh" });
    const shown = [];
    drag.addEventListener("frame", ({ frame }) => shown.push(frame.pose));
    const before = drag.pose(Q);
    await until(() => shown.includes(before), "a frame");
    await server.stop();
    await until(() => drag.state === "reconnecting", "reconnecting");
    const during = drag.pose(P);
    await pause(300);
    server = await serve({ port });
    await until(() => shown.includes(during), "a frame of the new server");
    assert.ok((await session.warp(Q)).blob.size);
    drag.close();
    await server.stop();
  });
});

describe("by a script", () => {
  const session = { id: "x", image: { width: 4, height: 3 }, p: [], grid: {} };
  const ask = async (answers, options = {}) => {
    const server = await scripted(answers);
    const client = new Client({ server: server.address, ...options });
    const result = await client
      .session("x")
      .refresh()
      .catch((error) => error);
    server.close();
    return { result, asked: server.asked };
  };

  test("which answers are repeated", async () => {
    for (const status of [408, 429, 502, 503, 504]) {
      const busy = problem(status, "overloaded", { "Retry-After": "0" });
      const { result, asked } = await ask([busy, busy, answer(session)]);
      assert.deepEqual([result.id, asked.length], ["x", 3], status);
    }
    for (const [status, code] of [
      [409, "superseded"],
      [410, "session_expired"],
      [404, "no_such_session"],
      [422, "bad_value"],
      [500, "internal"],
      [401, "unauthorized"],
    ]) {
      const { result, asked } = await ask([problem(status, code)]);
      assert.deepEqual([result.code, result.status, asked.length], [code, status, 1]);
    }
    const never = await ask([problem(503, "overloaded", { "Retry-After": "3600" })]);
    assert.deepEqual([never.result.retryAfter, never.asked.length], [3600, 1]);
    const begun = Date.now();
    const pauses = await ask([problem(503, "overloaded")], { maxRetries: 1 });
    assert.equal(pauses.asked.length, 2);
    assert.ok(Date.now() - begun >= 240);
    const proxy = (response) => response.writeHead(502).end("<html>bad gateway");
    const { result } = await ask([proxy], { maxRetries: 0 });
    assert.deepEqual([result.code, result.status], ["unavailable", 502]);
    assert.match(result.message, /bad gateway/);
  });

  test("a token that has expired is asked for again, once", async () => {
    const tokens = ["first", "second", "third"];
    let questions = 0;
    const auth = async () => tokens[questions++];
    const expired = problem(401, "token_expired");
    const { result, asked } = await ask([expired, answer(session)], { auth });
    assert.equal(result.id, "x");
    assert.deepEqual(
      asked.map(({ headers }) => headers.authorization),
      ["Bearer first", "Bearer second"],
    );
    const always = await ask([expired], { auth: () => "old" });
    assert.deepEqual([always.result.code, always.asked.length], ["token_expired", 2]);
    const key = await ask([expired], { auth: "a-key" });
    assert.deepEqual([key.result.code, key.asked.length], ["token_expired", 1]);
    const failing = await ask([answer(session)], { auth: () => Promise.reject(new Error("mine")) });
    assert.deepEqual([failing.result.message, failing.asked.length], ["mine", 0]);
  });

  test("an answer has a time limit", async () => {
    const silent = await ask([() => {}], { timeout: 60, maxRetries: 0 });
    assert.equal(silent.result.code, "no_answer");
    const half = (response) => {
      response.writeHead(200, { "Content-Length": "100" });
      response.write("{");
    };
    const stalled = await ask([half], { timeout: 60, maxRetries: 0 });
    assert.equal(stalled.result.code, "no_answer");
    const broken = (response) => {
      half(response);
      setTimeout(() => response.destroy(), 20);
    };
    const cut = await ask([broken, answer(session)], { maxRetries: 1 });
    assert.equal(cut.result.id, "x");
  });

  test("a drag gets a new token, and ends where it is not welcome", async () => {
    const { server, address, close } = await scripted([answer(session)]);
    const sockets = new WebSocketServer({ server, handleProtocols: () => "mlswarp" });
    const seen = [];
    sockets.on("connection", (socket, request) => {
      const [, bearer] = request.headers["sec-websocket-protocol"].split(",");
      seen.push(Buffer.from(bearer.trim().slice("mlswarp.bearer.".length), "base64url").toString());
      if (seen.length === 1) socket.close(1008, "token_expired");
      else if (seen.length === 2) socket.close(1013);
      else if (seen.length === 3) socket.close(1008, "too many messages");
    });
    let asked = 0;
    const client = new Client({ server: address, WebSocket, auth: () => `token ${++asked}` });
    const drag = client.session("x").drag();
    await until(() => drag.state === "closed", "closed");
    assert.deepEqual(seen, ["token 1", "token 2", "token 2"]);
    assert.match(drag.error.message, /too many messages/);
    assert.equal(drag.error.code, "closed");
    sockets.close();
    close();
  });

  test("a drag ends where the key is not welcome", async () => {
    const { address, asked, close } = await scripted([problem(403, "forbidden")]);
    const drag = new Client({ server: address, WebSocket, auth: "no-key" }).session("x").drag();
    await assert.rejects(
      async () => {
        for await (const _ of drag);
      },
      { code: "forbidden" },
    );
    assert.ok(asked.length >= 3);
    close();
  });

  test("a socket that answers nothing is given up, though it looks open", async () => {
    const { server, address, close } = await scripted([answer(session)]);
    const sockets = new WebSocketServer({ server });
    let opened = 0;
    sockets.on("connection", (socket) => {
      opened += 1;
      if (opened === 1) return;
      socket.on("message", (text) => {
        const { seq } = JSON.parse(text);
        if (seq) socket.send(Buffer.from(new BigUint64Array([BigInt(seq)]).buffer));
      });
    });
    const drag = new Client({ server: address, WebSocket }).session("x").drag();
    const pose = drag.pose(Q);
    for await (const frame of drag) {
      assert.equal(frame.pose, pose);
      break;
    }
    assert.equal(opened, 2);
    sockets.close();
    close();
  });

  test("an address that is none is refused at once", () => {
    assert.throws(() => new Client({ server: "warp.example" }), TypeError);
    assert.equal(new Client({ server: "http://a.example/warp//" }).server, "http://a.example/warp");
  });
});
