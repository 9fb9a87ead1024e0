"""The recipe for Dask, on a cluster of two processes on this machine."""

import runpy
import subprocess
import sys

import dask.array as da
import numpy as np
from mlswarp.augment import RandomWarp
from PIL import Image

from conftest import ROOT

RECIPE = ROOT / "api/python/examples/dask_batch.py"
PICTURE = ROOT / "tests/images/chelsea.png"


def test_a_stack_is_warped_by_two_processes(tmp_path):
    count, out = 10, tmp_path / "out.npy"
    subprocess.run([sys.executable, RECIPE, out, str(count), PICTURE], check=True, timeout=120)
    image = np.asarray(Image.open(PICTURE).convert("RGB"))
    size, warp = image.shape[1::-1], RandomWarp(sigma=6)
    poses = [warp.sample(np.random.default_rng(k), size) for k in range(count)]
    expected = np.stack([pose.warp(image) for pose in poses])
    assert (np.load(out) == expected).all()
    # Other chunks, also across images, in this process.
    images = da.broadcast_to(image, (count, *image.shape)).rechunk((3, 100, 200, -1))
    warped = runpy.run_path(str(RECIPE))["warp_all"](images)
    assert (warped.compute(scheduler="synchronous") == expected).all()
