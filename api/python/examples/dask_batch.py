"""Random variants of an image on a Dask cluster. A warp moves pixels across a whole image: a block
has whole images. A result depends on its number alone, not on chunks or workers.

    python dask_batch.py OUT.npy VARIANTS IMAGE      (DASK_ADDRESS: of a cluster)
"""

import os
import sys

import dask.array as da
import mlswarp
import numpy as np
from dask.distributed import Client
from mlswarp.augment import RandomWarp
from PIL import Image

WARP = RandomWarp(sigma=6)  # keeps its plans in each worker


def warp_block(images, block_info=None):
    first = block_info[0]["array-location"][0][0]
    size = images.shape[2:0:-1]
    poses = (WARP.sample(np.random.default_rng(first + k), size) for k in range(len(images)))
    return np.stack([pose.warp(image) for pose, image in zip(poses, images, strict=True)])


def warp_all(images):
    """Of a stack of images, `(n, H, W, C)`."""
    whole = images.rechunk({1: -1, 2: -1, 3: -1})
    return whole.map_blocks(warp_block, meta=np.empty((0, 0, 0, 0), images.dtype))


def main(out, variants, path):
    image = np.asarray(Image.open(path).convert("RGB"))
    images = da.broadcast_to(image, (int(variants), *image.shape)).rechunk({0: 4})
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    address = os.environ.get("DASK_ADDRESS")
    with Client(address) if address else Client(**local) as client:
        client.run(mlswarp.set_num_threads, 1)  # one worker a core
        np.save(out, warp_all(images).compute())


if __name__ == "__main__":
    main(*sys.argv[1:])
