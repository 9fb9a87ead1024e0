#!/usr/bin/env python3
"""The package for Python beside what people use instead, all in one run.

    tests/bench/python/run            builds the released wheel, and prints the tables

Every row is the least of several rounds, in which the contestants take turns: what else the machine
does only adds to it. `ready map`: the time without that of computing the map, which the others have
to do for each pose.
"""

import os
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import cv2
import mlswarp
import molesq
import numpy as np
import skimage.transform
from PIL import Image

ROUNDS = 7
SMALL = 500
# Seconds after which a contestant is slow.
LONG = 0.5
CV_THREADS = os.cpu_count() or 1


def moving_least_squares(p, q, width, height, alpha=1.0):
    """Rigid moving least squares for the inverse map, as a plain program of NumPy has it: every
    pixel, every handle, in float64. `p`, `q`: where the map begins and where it goes."""
    y, x = np.mgrid[:height, :width]
    v = np.stack([x + 0.5, y + 0.5], axis=-1).reshape(-1, 1, 2)
    w = 1 / (((p - v) ** 2).sum(axis=2) ** alpha + 1e-12)
    total = w.sum(axis=1, keepdims=True)
    centre_p = (w[:, :, None] * p).sum(axis=1) / total
    centre_q = (w[:, :, None] * q).sum(axis=1) / total
    from_p, from_q = p - centre_p[:, None], q - centre_q[:, None]
    dot = (w * (from_p * from_q).sum(axis=2)).sum(axis=1)
    cross = (w * (from_p[:, :, 0] * from_q[:, :, 1] - from_p[:, :, 1] * from_q[:, :, 0])).sum(
        axis=1
    )
    length = np.hypot(dot, cross) + 1e-12
    cos, sin = dot / length, cross / length
    d = v[:, 0] - centre_p
    turned = np.stack([cos * d[:, 0] - sin * d[:, 1], sin * d[:, 0] + cos * d[:, 1]], axis=-1)
    return (turned + centre_q - 0.5).reshape(height, width, 2).astype(np.float32)


def contestants(image, p, q):
    """Name and what is timed: one new pose of one image, and drawing it."""
    height, width = image.shape[:2]
    plan = mlswarp.Plan(p, like=image)
    pose = plan.pose(q)
    x, y = np.moveaxis(np.nan_to_num(pose.map(), nan=-1e6), 2, 0)
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    out = np.empty_like(image)

    def plain():
        moved = moving_least_squares(q, p, width, height)
        return cv2.remap(image, moved[:, :, 0], moved[:, :, 1], cv2.INTER_LINEAR)

    def thin_plate():
        transform = skimage.transform.ThinPlateSplineTransform.from_estimate(q, p)
        return skimage.transform.warp(image, transform, preserve_range=True)

    def piecewise():
        corners = [[0, 0], [width, 0], [0, height], [width, height]]
        rest, posed = np.vstack([p, corners]), np.vstack([q, corners])
        transform = skimage.transform.PiecewiseAffineTransform.from_estimate(posed, rest)
        return skimage.transform.warp(image, transform, preserve_range=True)

    rows = {
        "mlswarp: pose and warp": lambda: plan.pose(q).warp(image),
        "mlswarp: warp of a ready pose": lambda: pose.warp(image),
        "mlswarp: the same, into out": lambda: pose.warp(image, out=out),
        "mlswarp: plan, pose and warp": lambda: mlswarp.Plan(p, like=image).pose(q).warp(image),
        "mlswarp: pose, its map": lambda: plan.pose(q).map(),
        "cv2.remap, ready map": lambda: cv2.remap(image, x, y, cv2.INTER_LINEAR),
        "NumPy, map by moving least squares, and cv2.remap": plain,
        "skimage ThinPlateSplineTransform": thin_plate,
        "skimage PiecewiseAffineTransform": piecewise,
    }

    def molesq_warp():
        flipped = [np.asarray(one)[:, ::-1] for one in (p, q)]
        # Affine, and bilinear like the others.
        transformer = molesq.ImageTransformer(image, *flipped, color_dim=2, interp_order=1)
        return transformer.deform_viewport()

    return {**rows, "molesq": molesq_warp}, pose


def table(name, image, threads, slow, rounds=ROUNDS):
    """Prints the times; returns what did not run."""
    mlswarp.set_num_threads(threads)
    cv2.setNumThreads(threads)
    height, width = image.shape[:2]
    columns, rows = np.meshgrid(np.linspace(0.1, 0.9, 6), np.linspace(0.1, 0.9, 5))
    p = np.stack([columns * width, rows * height], axis=-1).reshape(-1, 2)
    q = p + np.random.default_rng(7).normal(0, width / 60, p.shape)
    timed, pose = contestants(image, p, q)
    times = {row: [] for row in timed}
    skipped = {}
    for turn in range(rounds + 1):
        for row, work in timed.items():
            # What takes long is timed once, and not at all on the larger image.
            if row in skipped or row in slow and (times[row] or width > SMALL):
                continue
            begun = time.perf_counter()
            try:
                work()
            except Exception as error:  # A peer that does not run is a row, not the end.
                skipped[row] = f"{type(error).__name__}: {error}"[:80]
                continue
            if turn or row in slow:
                times[row].append(time.perf_counter() - begun)
            elif time.perf_counter() - begun > LONG:
                times[row].append(time.perf_counter() - begun)
                slow.add(row)
    print(f"\n{name}, {len(p)} points, {threads} thread(s), {pose.folds} folds\n")
    print(f"| {'':<50} | {'ms':>9} | {'relative':>8} |\n|{'-' * 52}|{'-' * 10}:|{'-' * 9}:|")
    base = min(times["mlswarp: pose and warp"])
    for row, found in times.items():
        if row in skipped:
            print(f"| {row:<50} | {skipped[row]} |  |")
            continue
        if not found:
            continue
        least = min(found)
        print(f"| {row:<50} | {1e3 * least:>9.2f} | {least / base:>8.2f} |")
    return skipped


class Timed:
    """A native pose that keeps the seconds of its last image in the engine."""

    def __init__(self, native):
        self.native, self.seconds = native, 0.0

    def warp(self, *given):
        image, self.seconds = self.native.warp(*given)
        return image, self.seconds


def overhead(rounds=300):
    """What Python adds to the time in the engine: arrays in and out, options, the pool. Both times
    are of one call, so that what else the machine does weighs on both."""
    mlswarp.set_num_threads(1)
    image = np.random.default_rng(0).integers(0, 255, (SMALL, SMALL, 3), dtype=np.uint8)
    plan = mlswarp.Plan([[100, 100], [400, 400]], like=image)
    pose = plan.pose([[110, 100], [400, 390]])
    pose._native = engine = Timed(pose._native)
    pairs = []
    for _ in range(rounds):
        begun = time.perf_counter()
        pose.warp(image)
        pairs.append((time.perf_counter() - begun, engine.seconds))
    share = statistics.median(whole / inside for whole, inside in pairs) - 1
    inside = statistics.median(inside for _, inside in pairs)
    print(f"\noverhead of Python over the engine, 500 x 500: {100 * share:.1f} %", end=" ")
    print(f"({1e3 * inside:.2f} ms in the engine)")


def two_threads(name, image):
    """Whether two threads of Python do the same work in half of the time of one."""
    import threading

    mlswarp.set_num_threads(1)
    pose = mlswarp.Plan([[100, 100]], like=image).pose([[110, 100]])
    work = lambda: [pose.warp(image).shape for _ in range(40)]
    ratios = []
    for _ in range(ROUNDS):
        begun = time.perf_counter()
        work(), work()
        one = time.perf_counter() - begun
        threads = [threading.Thread(target=work) for _ in range(2)]
        begun = time.perf_counter()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        ratios.append((time.perf_counter() - begun) / one)
    least, middle = min(ratios), statistics.median(ratios)
    print(f"{name}, two threads of Python: {least:.2f} of the time of one, median {middle:.2f}")


def peak_mib():
    """Of this process; `ru_maxrss` would be that of the parent as well."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+)", status)[1]) >> 10


def stimuli():
    """1,000 stimuli of 696 x 768: time and memory of a new process."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (768, 696, 3), dtype=np.uint8)
    columns, rows = np.meshgrid(np.linspace(100, 600, 8), np.linspace(100, 660, 9))
    plan = mlswarp.Plan(np.stack([columns, rows], axis=-1).reshape(-1, 2), like=image)
    before = peak_mib()
    begun = time.perf_counter()
    for pose in plan.jitter(sigma=6, count=1000, seed=7):
        pose.warp(image)
    seconds = time.perf_counter() - begun
    threads = mlswarp.get_num_threads()
    print(f"1,000 stimuli of 696 x 768, 72 points, {threads} threads: {seconds:.1f} s,", end=" ")
    print(f"peak {peak_mib()} MiB (before: {before} MiB)")


def main():
    # In a process of their own, without what the other libraries leave behind.
    alone = {"stimuli": stimuli, "overhead": overhead}
    if work := alone.get(sys.argv[1]):
        return work()
    picture = Image.open(sys.argv[1]).convert("RGB")
    small = np.asarray(picture.resize((SMALL, SMALL)))
    large = np.asarray(picture.resize((1920, 1080)))
    for threads in sorted({1, CV_THREADS}):
        slow = set()
        table("500 x 500", small, threads, slow)
        table("1920 x 1080", large, threads, slow)
    subprocess.run([sys.executable, __file__, "overhead"], check=True)
    two_threads("500 x 500", small)
    two_threads("1920 x 1080", large)
    subprocess.run([sys.executable, __file__, "stimuli"], check=True)
    code = "import numpy, time; t = time.perf_counter(); import mlswarp; "
    code += "print(time.perf_counter() - t)"
    found = [subprocess.check_output([sys.executable, "-c", code]) for _ in range(5)]
    print(f"import after NumPy: {1e3 * statistics.median(map(float, found)):.0f} ms")


if __name__ == "__main__":
    main()
