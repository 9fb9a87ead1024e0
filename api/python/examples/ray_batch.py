"""Random variants of images on a Ray cluster. Each worker keeps its plans, and a result depends on
its image and seed alone: what a lost worker had is computed again, the same.

    python ray_batch.py OUT VARIANTS IMAGE...      (RAY_ADDRESS: of a cluster; WORKERS)
"""

import os
import sys
from pathlib import Path

import mlswarp
import numpy as np
import ray
from mlswarp.augment import RandomWarp
from PIL import Image


class Warp:
    def __init__(self):
        mlswarp.set_num_threads(1)  # one worker a core
        self.warp = RandomWarp(sigma=6)

    def __call__(self, row):
        image = np.asarray(Image.open(row["path"]).convert("RGB"))
        pose = self.warp.sample(np.random.default_rng(row["seed"]), image.shape[1::-1])
        name = f"{Path(row['path']).stem}-{row['seed']}.png"
        Image.fromarray(pose.warp(image)).save(Path(row["out"], name))
        return {"name": name, "folds": pose.folds}


def main(out, variants, *paths):
    workers, out = int(os.environ.get("WORKERS", "2")), str(Path(out).resolve())
    rows = [{"path": p, "seed": s, "out": out} for p in paths for s in range(int(variants))]
    jobs = ray.data.from_items(rows, override_num_blocks=4 * workers)
    done = jobs.map(Warp, compute=ray.data.ActorPoolStrategy(size=workers), num_cpus=1).take_all()
    print(len(done), "images,", sum(row["folds"] for row in done), "folded cells")


if __name__ == "__main__":
    main(*sys.argv[1:])
