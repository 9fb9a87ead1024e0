// The package in Node: the same bytes as the program, and what happens to memory.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { existsSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { pathToFileURL } from "node:url";

import { Engine, EngineCrashed, MlswarpError } from "mlswarp/engine";
import { Engine as Inline } from "mlswarp/engine/inline";

import { PICTURES, ending } from "./list.mjs";

const sha = (bytes) => createHash("sha256").update(bytes).digest("hex");
const image = (name) => readFileSync(`../../../../images/${name}`);
const object = (name) => JSON.parse(readFileSync(`${name}.json`, "utf8"));
// Another file than that of the package, for the same tests.
const wasm = process.env.MLSWARP_WASM && pathToFileURL(process.env.MLSWARP_WASM);
const load = () => Engine.load(wasm || undefined);
const handles = [
  [168, 112],
  [316, 136],
  [262, 240],
];
const moved = [
  [168, 112],
  [316, 136],
  [262, 270],
];

test("files are the same bytes as the program's", async () => {
  const engine = await load();
  for (const [name, file] of Object.entries(PICTURES)) {
    const made = engine.warpFile(image(file), object(name));
    const expected = readFileSync(`../expected/${name}.${ending(name)}`);
    assert.equal(sha(made), sha(expected), name);
  }
});

test("pixels are those of the file", async () => {
  const engine = await load();
  const [width, height] = [64, 48];
  const data = Uint8ClampedArray.from({ length: width * height * 4 }, (_, k) => (k * 37) % 251);
  for (let k = 3; k < data.length; k += 4) data[k] = 255;
  using_(engine.plan([[20, 20]], { size: [width, height] }), (plan) => {
    using_(plan.pose([[21, 20]]), (pose) => {
      const drawn = pose.warp({ width, height, data });
      assert.deepEqual([drawn.width, drawn.height], [width, height]);
      assert.equal(drawn.data[3], 0, "nothing covers the first column");
      assert.deepEqual(drawn.data.slice(4, width * 4), data.slice(0, width * 4 - 4));
      using_(engine.image({ width, height, data }), (kept) =>
        assert.deepEqual(pose.warp(kept).data, drawn.data),
      );
      const wide = pose.warp({ width, height, data }, { canvas: "fit", width: 130 });
      assert.equal(wide.data.length, wide.width * wide.height * 4);
      for (const kind of [Uint8Array, Uint16Array, Uint32Array]) {
        const labels = kind.from({ length: width * height }, (_, k) => k % 251);
        const posed = pose.labels({ width, height, data: labels });
        assert.equal(posed.data.constructor, kind);
        assert.deepEqual(posed.data.slice(0, 4), kind.of(0, 0, 1, 2));
      }
      assert.deepEqual([...pose.coverage().data.slice(0, 2)], [0, 255]);
    });
  });
  assert.equal(engine.objects, 0);
});

test("positions go there and back, and maps and meshes agree with them", async () => {
  const engine = await load();
  const plan = engine.plan(handles, { size: [451, 300], method: "similarity" });
  const pose = plan.pose(moved);
  assert.ok(pose.residual < 0.25 && pose.folds === 0 && !pose.report.mirrored);
  const there = pose.points(handles);
  for (const [k, [x, y]] of moved.entries())
    assert.ok(Math.hypot(there[2 * k] - x, there[2 * k + 1] - y) < 1e-9);
  const back = pose.points(there, { inverse: true });
  for (const [k, [x, y]] of handles.entries())
    assert.ok(Math.hypot(back[2 * k] - x, back[2 * k + 1] - y) < 1e-6);
  assert.ok(Number.isNaN(pose.points([[-5000, 0]], { inverse: true })[0]));
  const map = pose.map();
  assert.equal(map.length, 451 * 300 * 2);
  const at = 2 * (150 * 451 + 200);
  const source = pose.points([[200.5, 150.5]], { inverse: true });
  assert.ok(Math.hypot(map[at] - source[0], map[at + 1] - source[1]) < 0.3);
  const { columns, rows, xy } = pose.mesh();
  assert.equal(xy.length, 2 * columns * rows);
  const half = plan.pose(moved, 0.5).points([[262, 240]]);
  assert.ok(Math.abs(half[1] - 255) < 1e-9);
});

test("images are added, and nothing of a blend stays in memory", async () => {
  const engine = await load();
  const [width, height] = [60, 40];
  const noise = (factor) => {
    const data = Uint8ClampedArray.from(
      { length: width * height * 4 },
      (_, k) => (k * factor) % 251,
    );
    for (let k = 3; k < data.length; k += 4) data[k] = 255;
    return { width, height, data };
  };
  const [one, other] = [noise(37), noise(11)];
  const [p, q] = [
    [
      [10, 10],
      [50, 12],
      [30, 30],
    ],
    [
      [14, 10],
      [50, 16],
      [30, 34],
    ],
  ];
  const entries = (shape, colour) =>
    [p, q].map((p, image) => ({ image, p, shape: shape[image], colour: colour[image] }));
  const alone = engine.blend([one], { images: [{ image: 0, p }] });
  assert.deepEqual(alone.image.data, one.data, "one image is itself");
  assert.deepEqual([alone.landmarks, alone.clamped, alone.folds], [p, 0, [0]]);
  // The colours of the first image in a shape half way: a warp of that image.
  const options = { align: "none", method: "rigid", alpha: 2 };
  const shape = engine.blend([one, other], { ...options, images: entries([0.5, 0.5], [1, 0]) });
  const plan = engine.plan(p, { size: [width, height], method: "rigid", alpha: 2 });
  const half = p.map(([x, y], k) => [(x + q[k][0]) / 2, (y + q[k][1]) / 2]);
  assert.deepEqual(shape.landmarks, half);
  assert.deepEqual(shape.image.data, plan.pose(half).warp(one).data);
  // Colours alone, of images that are kept.
  const kept = [one, other].map((image) => engine.image(image));
  const same = [0, 1].map((image) => ({ image, p }));
  const mean = engine.blend(kept, { images: same }).image.data;
  mean.forEach((value, k) =>
    assert.ok(Math.abs(value - (one.data[k] + other.data[k]) / 2) <= 0.5, `${k}`),
  );
  kept.forEach((image) => image.dispose());
  const frames = [...engine.blendFrames([one, other], { images: same, steps: 3 })];
  assert.deepEqual(
    [frames[0], frames[1], frames[2]].map(({ image }) => image.data),
    [one.data, mean, other.data],
  );
  assert.throws(
    () => engine.blend([one, other], { images: same, steps: 3 }),
    /3 results: use blendFrames/,
  );
  assert.throws(
    () => engine.blend([one], { images: [{ image: 0, p, shape: 2, colour: 1 }] }),
    (error) => error instanceof MlswarpError && error.pointer === "/images/0/shape",
  );
  assert.throws(() => engine.blend([], { images: [{ image: 0, p }] }), MlswarpError);
  for (const _ of engine.blendFrames([one, other], { images: same, steps: 1000 })) break;
  const invalid = { ...other, data: new Float32Array(4) };
  assert.throws(() => engine.blend([one, invalid], { images: same }), /Uint8ClampedArray/);
  // An image of another engine would be whatever has its number here.
  const foreign = (await load()).image(one);
  assert.throws(() => engine.blend([one, foreign], { images: same }), /of another engine/);
  assert.throws(() => plan.pose(half).warp(foreign), /of another engine/);
  plan.dispose();
  // Two of its poses were forgotten, not disposed of.
  assert.equal(engine.objects, 2);
});

test("landmark files are read", async () => {
  const engine = await load();
  const file = new TextEncoder().encode("version: 1\nn_points: 2\n{\n10 20\n30 40\n}\n");
  const read = engine.landmarks(file);
  assert.equal(read.p.length, 2);
  assert.equal(read.format, "pts");
  assert.deepEqual(engine.landmarks(file, file).q, read.p);
  assert.throws(
    () => engine.landmarks(new TextEncoder().encode("version: 1\nn_points: 2\n{\n10\n}\n")),
    (error) => error instanceof MlswarpError && error.code === "bad_landmarks",
  );
});

test("errors have the code and the place that the service gives", async () => {
  const engine = await load();
  const cases = [
    [{ p: [[1, 2]], q: [[1, "x"]] }, "bad_value", "/q/0/1"],
    [
      {
        p: [[1, 2]],
        q: [
          [1, 2],
          [3, 4],
        ],
      },
      "shape_mismatch",
      undefined,
    ],
    [{ p: [[1, 2]], q: [[1, 2]], methd: 1 }, "unknown_field", "/methd"],
    [{ p: [[1, 2]], q: [[1, NaN]] }, "not_finite", "/q/0/1"],
    [{ p: [[1, 2]], q: [[1, 2]], strength: NaN }, "not_finite", "/strength"],
    [{ p: [[1, 2]], q: [[1, 2]], alpha: Infinity }, "not_finite", "/alpha"],
    [
      { p: [[1, 2]], q: [[1, 2]], output: { format: "png", quality: 3000 } },
      "bad_value",
      "/output/quality",
    ],
  ];
  for (const [warp, code, pointer] of cases) {
    const refused = (error) => {
      assert.ok(error instanceof MlswarpError, String(error));
      assert.equal(error.code, code);
      if (pointer) assert.equal(error.pointer, pointer);
      return true;
    };
    assert.throws(() => engine.warpFile(image("chelsea.png"), warp), refused);
  }
  assert.throws(() => engine.warpFile(new Uint8Array(9), object("cat")), MlswarpError);
  assert.throws(() => engine.plan(handles, { size: [0, 3] }), MlswarpError);
  assert.equal(engine.objects, 0);
});

test("what follows the outline of an image bends one leg alone", async () => {
  const engine = await load();
  const size = [60, 60];
  const data = new Uint8ClampedArray(4 * 60 * 60);
  // Two legs that join above.
  for (let k = 0; k < 3600; k++)
    data[4 * k + 3] = k < 1200 || Math.abs((k % 60) - 30) > 10 ? 255 : 0;
  const rest = [10, 50].flatMap((x) => [5, 55].map((y) => [x, y]));
  const posed = rest.map(([x, y], k) => (k === 1 ? [x - 6, y - 4] : [x, y]));
  const moved = (options) => {
    const plan = engine.plan(rest, { size, ...options });
    const pose = plan.pose(posed);
    const [x, y] = pose.points([[45, 50]]);
    for (const held of [pose, plan]) held.dispose();
    return Math.hypot(x - 45, y - 50);
  };
  const image = engine.image({ width: 60, height: 60, data });
  const outline = engine.outline(image);
  const across = moved({});
  assert.ok(moved({ metric: "geodesic", outline }) < across / 3);
  assert.ok(moved({ method: "arap", outline }) < across / 3);
  assert.equal(moved({ outline }), across, "nothing else follows it");
  for (const options of [{ metric: "geodesic" }, { method: "arap" }])
    assert.throws(() => moved(options), MlswarpError);
  assert.throws(() => engine.plan(rest, { size: [50, 60], metric: "geodesic", outline }), {
    message: "the outline is of 60x60 px, and `size` is 50x60",
  });

  // Of a file, and within a region; both may be images too.
  const file = engine.outline(readFileSync("../../../../images/horse-cutout.png"));
  const plan = engine.plan([[330, 215]], {
    size: [800, 656],
    metric: "geodesic",
    outline: file,
  });
  const white = new Uint8ClampedArray(4 * 3600).fill(255);
  const region = engine.image({ width: 60, height: 60, data: white });
  const within = engine.outline(image, { region });
  assert.ok(moved({ metric: "geodesic", outline: within }) < across / 3);
  assert.throws(
    () => engine.outline(readFileSync("../../../../images/chelsea.png"), { region }),
    MlswarpError,
  );
  for (const held of [image, outline, file, plan, region, within]) held.dispose();
  assert.equal(engine.objects, 0);
});

test("a thousand plans take the memory of one", async () => {
  const engine = await load();
  const once = () =>
    using_(
      engine.plan(
        [
          [20, 20],
          [50, 40],
        ],
        { size: [64, 48] },
      ),
      (plan) =>
        using_(
          plan.pose([
            [24, 20],
            [50, 44],
          ]),
          (pose) => pose.coverage(),
        ),
    );
  for (let k = 0; k < 10; k++) once();
  const before = engine.memoryBytes;
  for (let k = 0; k < 1000; k++) once();
  assert.equal(engine.memoryBytes, before);
  assert.equal(engine.objects, 0);
});

test("what was forgotten is freed", async () => {
  const engine = await load();
  for (let k = 0; k < 50; k++) engine.plan(handles, { size: [451, 300] });
  for (let k = 0; k < 50 && engine.objects > 0; k++) {
    globalThis.gc?.();
    await new Promise((done) => setTimeout(done, 10));
  }
  if (globalThis.gc) assert.equal(engine.objects, 0);
});

test("a panic ends one engine, with its text, and the next one works", async () => {
  const [engine, other] = [await load(), await load()];
  const plan = engine.plan(handles, { size: [451, 300] });
  const ended = (error) =>
    error instanceof EngineCrashed && /a panic for tests/.test(error.message);
  assert.throws(() => Engine.panicForTests(engine), ended);
  assert.throws(() => plan.pose(moved), ended);
  plan.dispose();
  assert.equal(other.plan(handles, { size: [451, 300] }).pose(moved).folds, 0);
  assert.equal((await load()).plan(handles, { size: [451, 300] }).pose(moved).folds, 0);
});

test("what was disposed of says so, and results stay", async () => {
  const engine = await load();
  const plan = engine.plan(handles, { size: [451, 300] });
  const pose = plan.pose(moved);
  plan.dispose();
  plan.dispose();
  assert.throws(() => plan.pose(moved), /Plan has been disposed of/);
  const { xy } = pose.mesh();
  const first = xy[0];
  // Memory that grows detaches every view of it.
  engine.plan(handles, { size: [4000, 3000], grid: { cell: 4 } });
  assert.equal(xy[0], first);
  engine.dispose();
  assert.throws(() => pose.mesh(), EngineCrashed);
});

test("the file is found by address, bytes and module, and inline", async () => {
  const file = existsSync("node_modules/mlswarp/mlswarp.wasm")
    ? readFileSync("node_modules/mlswarp/mlswarp.wasm")
    : assert.fail();
  const response = new Response(file, { headers: { "Content-Type": "application/wasm" } });
  const sources = [file, await WebAssembly.compile(file), response, new Response(file)];
  for (const source of sources)
    assert.equal((await Engine.load(source)).plan(handles, { size: [9, 9] }).handles, 3);
  const inline = await Inline.load();
  const made = inline.warpFile(image("chelsea.png"), object("cat"));
  assert.equal(sha(made), sha(readFileSync("../expected/cat.png")));
  await assert.rejects(Engine.load(new Response("", { status: 404 })), /404/);
});

/** `using` for a Node that has no such statement. */
function using_(held, work) {
  try {
    return work(held);
  } finally {
    held[Symbol.dispose]();
  }
}
