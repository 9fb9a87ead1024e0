#!/usr/bin/env python3
"""The engine as WebAssembly in Node beside the native one on one thread: q to pixels.

    tests/bench/engines.py [FILE.wasm ...]    prints a table, in half a minute

Needs the package for Python with the release profile (as `tests/bench/python/run` installs it; or
PYTHONPATH), and Node 20. Without a file: the committed one. Every figure is the least of several
rounds in which the engines take turns, in one process each; all must draw the same bytes.
"""

import hashlib
import json
import subprocess
import sys
import time
from pathlib import Path

import mlswarp
import numpy as np

ROOT = Path(__file__).parents[2]
# The first dozens of calls are of code that has not been optimised yet; a drag has hundreds.
ROUNDS = 60
SIZES = (500, 500), (1920, 1080)
COUNTS = 7, 68, 478

# Answers a line with a scene, and then each line that is empty with one round.
NODE = """
const [engine, file] = process.argv.slice(1);
const { Engine } = await import(engine);
const { readFile } = await import("node:fs/promises");
const { createHash } = await import("node:crypto");
const loaded = await Engine.load(await readFile(file));
const lines = (await import("node:readline")).createInterface({ input: process.stdin });
let image, plan, q;
for await (const line of lines) {
  if (line) {
    const scene = JSON.parse(line);
    plan?.dispose();
    image?.dispose();
    const data = new Uint8ClampedArray(await readFile(scene.pixels));
    const [width, height] = scene.size;
    image = loaded.image({ width, height, data });
    plan = loaded.plan(scene.p, { size: scene.size });
    q = scene.q;
  }
  const began = performance.now();
  const pose = plan.pose(q);
  const posed = performance.now();
  const drawn = pose.warp(image);
  const ended = performance.now();
  pose.dispose();
  const digest = line && createHash("sha256").update(drawn.data).digest("hex");
  console.log(JSON.stringify([posed - began, ended - posed, digest]));
}
"""


def scene(size, count):
    """Handles on a shaken lattice over the picture, moved in waves of a hundredth of its height."""
    width, height = size
    random = np.random.default_rng(count)
    columns = int(np.ceil(np.sqrt(count * width / height)))
    rows = int(np.ceil(count / columns))
    k = np.arange(count)
    cell = np.stack([k % columns, k // columns], axis=1)
    p = (cell + 0.5 + 0.3 * random.uniform(-1, 1, (count, 2))) / (columns, rows) * size
    turn = p[:, ::-1] * (2 * np.pi / height) + (0, 1)
    return p, p + 0.01 * height * np.sin(turn)


class Native:
    name = "native"

    def start(self, pixels, p, q):
        self.image, self.plan, self.q = pixels, mlswarp.Plan(p, like=pixels), q
        return hashlib.sha256(self.round()[2]).hexdigest()

    def round(self):
        began = time.perf_counter()
        pose = self.plan.pose(self.q)
        posed = time.perf_counter()
        drawn = pose.warp(self.image)
        ended = time.perf_counter()
        return 1e3 * (posed - began), 1e3 * (ended - posed), drawn


class Web:
    def __init__(self, file):
        self.name = Path(file).name
        engine = ROOT / "api/npm/engine/index.js"
        command = ["node", "--input-type=module", "--eval", NODE, engine.as_uri(), str(file)]
        self.node = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def start(self, pixels, p, q):
        height, width = pixels.shape[:2]
        raw = ROOT / "tests/artefacts/engines.rgba"
        raw.parent.mkdir(exist_ok=True)
        pixels.tofile(raw)
        size = [width, height]
        line = {"pixels": str(raw), "size": size, "p": p.tolist(), "q": q.tolist()}
        return self.round(json.dumps(line))[2]

    def round(self, line=""):
        print(line, file=self.node.stdin, flush=True)
        return json.loads(self.node.stdout.readline())


def main():
    mlswarp.set_num_threads(1)
    files = sys.argv[1:] or [ROOT / "api/npm/mlswarp.wasm"]
    engines = [Native(), *map(Web, files)]
    print("| size | handles | engine | pose, ms | draw, ms | together | / native |")
    print("|---|---|---|---|---|---|---|")
    for size in SIZES:
        y, x = np.mgrid[: size[1], : size[0]]
        noise = np.random.default_rng(1).integers(0, 16, (*x.shape, 3))
        waves = 120 + 100 * np.sin(np.stack([x / 31, y / 23, (x + y) / 47], axis=2))
        pixels = np.dstack([waves + noise, np.full(x.shape, 255)]).astype(np.uint8)
        for count in COUNTS:
            p, q = scene(size, count)
            digests = {engine.start(pixels, p, q) for engine in engines}
            assert len(digests) == 1, "the engines draw other bytes"
            rounds = [[engine.round()[:2] for engine in engines] for _ in range(ROUNDS)]
            least = np.array(rounds).min(axis=0)
            together = np.array(rounds).sum(axis=2).min(axis=0)
            for engine, (pose, draw), both in zip(engines, least, together, strict=True):
                print(
                    f"| {size[0]} x {size[1]} | {count} | {engine.name} | {pose:.2f} | {draw:.2f}"
                    f" | {both:.2f} | {both / together[0]:.1f} |"
                )


if __name__ == "__main__":
    main()
