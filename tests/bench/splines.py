"""Compares the method `tps` with scipy's RBFInterpolator (kernel `thin_plate_spline`) in the same
normalised coordinates: the largest difference of mapped points, as a share of the largest
displacement of a handle. Fails if it is more than 1e-9, or for many points more than the rounding
of the coordinates alone may change: the condition number of the system times 2^-52.

    python3 -m venv target/splines && target/splines/bin/pip install -r tests/bench/splines.txt
    cargo build --release && target/splines/bin/python tests/bench/splines.py

The program is target/release/mlswarp, or the one in MLSWARP_PROGRAM=path. The script uses only the
loopback interface."""

import json
import os
import pathlib
import re
import subprocess
import time
import urllib.request

import numpy
from scipy.interpolate import RBFInterpolator

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("MLSWARP_PROGRAM", ROOT / "target" / "release" / "mlswarp")
PLACES = 500


def started():
    """The program and its address."""
    environment = {name: value for name, value in os.environ.items() if name != "MLSWARP_LISTEN"}
    server = subprocess.Popen(
        [PROGRAM, "serve", "--listen", "127.0.0.1:0"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    for line in server.stdout:
        if found := re.search(r"http://[0-9.]+:[0-9]+", line):
            return server, found[0]
    raise SystemExit("the program did not start")


def ours(address, size, p, q, smoothing, places):
    """The mapped places, and the seconds that the request took."""
    body = {
        "p": p.tolist(),
        "q": q.tolist(),
        "method": "tps",
        "smoothing": smoothing,
        "extent": [size, size],
        "points": places.tolist(),
    }
    request = urllib.request.Request(
        f"{address}/points", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    began = time.perf_counter()
    with urllib.request.urlopen(request, timeout=120) as response:
        return numpy.array(json.load(response)["points"]), time.perf_counter() - began


def theirs(p, q, smoothing, places):
    """Their kernel r^2 ln r is half of ours, and so is their smoothing."""
    began = time.perf_counter()
    mean = p.mean(axis=0)
    unit = numpy.sqrt(((p - mean) ** 2).sum(axis=1).mean())
    spline = RBFInterpolator(
        (p - mean) / unit, q - p, smoothing=smoothing / 2, kernel="thin_plate_spline", degree=1
    )
    return places + spline((places - mean) / unit), time.perf_counter() - began


def allowed(p, smoothing):
    p = (p - p.mean(axis=0)) / numpy.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean())
    r2 = ((p[:, None] - p[None]) ** 2).sum(axis=2)
    kernel = r2 * numpy.log(numpy.where(r2 > 0, r2, 1)) + smoothing * numpy.eye(len(p))
    sides = numpy.hstack([numpy.ones((len(p), 1)), p])
    system = numpy.block([[kernel, sides], [sides.T, numpy.zeros((3, 3))]])
    return max(1e-9, numpy.finfo(float).eps * numpy.linalg.cond(system, 1))


def compare(address):
    random = numpy.random.default_rng(7)
    failed = 0
    print(
        f"{'points':>6} {'image':>6} {'smoothing':>9} {'difference':>10} {'allowed':>8} "
        f"{'ours, s':>8} {'scipy, s':>8}"
    )
    for count in (3, 4, 11, 50, 200, 1000, 2000):
        for size in (500, 10_000):
            for smoothing in (0, 1e-3, 0.1, 10):
                p = random.uniform(0, size, (count, 2))
                q = p + random.uniform(-0.05 * size, 0.05 * size, (count, 2))
                places = random.uniform(-0.2 * size, 1.2 * size, (PLACES, 2))
                (mapped, seconds), (expected, their_seconds) = (
                    ours(address, size, p, q, smoothing, places),
                    theirs(p, q, smoothing, places),
                )
                difference = numpy.abs(mapped - expected).max() / numpy.abs(q - p).max()
                limit = allowed(p, smoothing)
                failed += not difference <= limit
                print(
                    f"{count:6} {size:6} {smoothing:9} {difference:10.1e} {limit:8.1e} "
                    f"{seconds:8.3f} {their_seconds:8.3f}",
                    flush=True,
                )
    return failed


server, address = started()
try:
    failed = compare(address)
finally:
    server.terminate()
    server.wait()
raise SystemExit(f"{failed} comparisons failed" if failed else 0)
