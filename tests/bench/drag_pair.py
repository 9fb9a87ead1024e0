#!/usr/bin/env python3
"""Compares the drag sockets of two release builds of the program on the loopback, drag by drag in
turns.

    drag_pair.py OLD NEW [DRAGS]        with the Python environment of tests/e2e

DRAGS of each program and choice of frames: 9 by default.

A drag is three seconds of poses at 125 Hz. The age of a frame is the time from sending its pose to
having all of it. Prints frames per second, and p50 and p99 of the ages in milliseconds: medians
over the drags of each program, and their ratios (new / old). Both programs run, one of them idle;
only the ratios of one run mean something.
"""

import json
import random
import sys
import threading
import time
from statistics import median, quantiles

from websockets.sync.client import connect

from programs import pose, running

RATE = 125
POSES = 3 * RATE


def drag(program, frames):
    """Frames per second, and p50 and p99 of their ages, ms."""
    sent, ages = {}, []
    address = f"ws://127.0.0.1:{program.connection.port}/sessions/{program.session}/drag?{frames}"
    with connect(address, max_size=None, compression=None) as socket:
        socket.recv()

        def move():
            began = time.perf_counter()
            for k in range(1, POSES + 1):
                time.sleep(max(0, began + k / RATE - time.perf_counter()))
                sent[k] = time.perf_counter()
                socket.send(json.dumps({"seq": k, "q": pose(k)}))

        moving = threading.Thread(target=move)
        moving.start()
        newest = 0
        while newest < POSES:
            newest = int.from_bytes(socket.recv()[:8], "little")
            ages.append((time.perf_counter() - sent[newest]) * 1e3)
            socket.send(json.dumps({"ack": newest}))
        moving.join()
    shares = quantiles(ages, n=100)
    return len(ages) * RATE / POSES, shares[49], shares[98]


def main():
    old, new, *drags = sys.argv[1:]
    with running(old, new) as programs:
        for frames in ("frames=png", "frames=jpeg", "frames=mesh"):
            runs = ([], [])
            for _ in range(int(drags[0]) if drags else 9):
                for k in random.sample([0, 1], 2):
                    runs[k].append(drag(programs[k], frames))
            before, after = (
                [median(run[column] for run in each) for column in range(3)] for each in runs
            )
            columns = zip(("frames/s", "p50", "p99"), before, after, strict=True)
            figures = (f"{name} {a:.2f} {b:.2f}, ratio {b / a:.3f}" for name, a, b in columns)
            print(f"{frames}: {'; '.join(figures)}", flush=True)


if __name__ == "__main__":
    main()
