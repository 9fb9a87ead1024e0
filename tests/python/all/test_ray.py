"""The recipe for Ray, on a cluster of two workers on this machine, one of which is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from mlswarp.augment import RandomWarp
from PIL import Image

from conftest import ROOT

CODE = """
import runpy, sys, ray
ray.init(num_cpus=2, include_dashboard=False, _node_ip_address="127.0.0.1", log_to_driver=False)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def workers():
    """The processes of the recipe's actors."""
    found = []
    for process in Path("/proc").iterdir():
        try:
            if b"MapWorker(" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except (OSError, ValueError):
            continue
    return found


def test_a_killed_worker_loses_nothing(tmp_path):
    path = ROOT / "tests/images/chelsea.png"
    variants = 60
    run = subprocess.Popen(
        [sys.executable, "-c", CODE, ROOT / "api/python/examples/ray_batch.py"]
        + [tmp_path, str(variants), path],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "RAY_DATA_DISABLE_PROGRESS_BARS": "1"},
    )
    killed = None
    while run.poll() is None and killed is None:
        if any(tmp_path.iterdir()) and (found := workers()):
            killed = found[0]
            os.kill(killed, signal.SIGKILL)
        time.sleep(0.01)
    answer, _ = run.communicate(timeout=120)
    assert run.returncode == 0 and killed is not None
    assert f"{variants} images, 0 folded cells" in answer
    image = np.asarray(Image.open(path).convert("RGB"))
    for seed in range(variants):
        pose = RandomWarp(sigma=6).sample(np.random.default_rng(seed), image.shape[1::-1])
        saved = np.asarray(Image.open(tmp_path / f"chelsea-{seed}.png"))
        assert (saved == pose.warp(image)).all(), seed
