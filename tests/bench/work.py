#!/usr/bin/env python3
"""What an operation of `--max-work` costs, for most kinds of task. The count is the first estimate
for which a server that allows one operation refuses the request; what follows it in the same
request (the cells of `/report`, the grid of a spline) is in the seconds and not in the count.
Positions are counted while they are computed: theirs is from the table in deploy/capacity.md.
Outlines, the removal of folds and frames that are posed by a table are not measured. Seconds are
those that the threads of the server computed, so that other processes of a busy machine change them
little.

    tests/bench/work.py PROGRAM

Prints operations, seconds and nanoseconds an operation. The limit protects only if an operation of
each kind costs about the same: the exit status is 1 if the most expensive kind costs more than
sixteen times the cheapest one.
"""

import json
import math
import pathlib
import subprocess
import sys
import time

from attacks import HOST, PORT, ask, connect
from programs import JSON

FREE = PORT + 1


def places(count, width=600, height=400):
    """Spread evenly, no two at one place."""
    return [
        [width * ((k * 0.6180339887) % 1), height * ((k * 0.7548776662 + 0.3) % 1)]
        for k in range(count)
    ]


def moved(points, by):
    return [[x + by * math.sin(y / 40), y + by * math.cos(x / 50)] for x, y in points]


def body(count, extent=(600, 400), by=3, **more):
    p = places(count, *extent)
    return {"extent": list(extent), "p": p, "q": moved(p, by), **more}


def lines(count, **more):
    at = places(count)
    return {
        "extent": [600, 400],
        "p": [[[x, y], [x + 20, y + 5]] for x, y in at],
        "q": [[[x + 2, y], [x + 22, y + 9]] for x, y in at],
        **more,
    }


SPLINES = [{"method": "tps", "smoothing": k / 10} for k in range(8)]
POINTS = places(20_000)
# Vertices of a grid of pixels, and operations for the coefficients of one and for its cell.
CELLS = 601 * 401 * (7 + 40)
# No two kinds have the same handles: the coefficients of one would serve the other.
KINDS = {
    "positions, 1,000 handles": ("/points", body(1000, points=POINTS), 20_000 * 2001),
    "positions, inverse": ("/points", body(300, points=POINTS, inverse=True), 20_000 * 601 * 8),
    "positions, 200 lines": ("/points", lines(200, points=POINTS), 20_000 * 3201),
    "positions, 200 lines, a logarithm": (
        "/points",
        lines(200, points=POINTS, alpha=0.75),
        20_000 * 3201,
    ),
    "grid of pixels": ("/map", body(100, grid="pixel")),
    "grid of pixels, a logarithm": ("/map", body(101, grid="pixel", alpha=0.75)),
    "grid of pixels, 20 lines": ("/map", lines(20, grid="pixel")),
    "default grid, 2,000 handles": ("/report", body(2000)),
    "cells of pixels": ("/report", body(3, grid="pixel"), CELLS),
    "spline of 1,500 points": ("/report", body(1500, method="tps")),
    "fit of 100 landmarks": ("/fit", body(100)),
    "fit of 300 landmarks": ("/fit", body(300)),
    "fit of 1,000 landmarks, no spline": ("/fit", body(1000, candidates=[{"method": "rigid"}] * 4)),
    "fit of 300 landmarks, splines": ("/fit", body(300, candidates=SPLINES)),
    "Beier-Neely, 100 lines": (
        "/report",
        lines(100, grid="pixel", method="beier_neely"),
    ),
}


def refused(path, request):
    """The operations that the strict server counts in this request."""
    text = json.dumps(request)
    status, data, _ = ask(connect(PORT), "POST", path, text, JSON)
    if status != 413:
        raise SystemExit(f"{path} is not counted: {status} {data[:200]}")
    return json.loads(data)["actual"]


def thread_seconds(server):
    """What its threads have computed, which other processes of a busy machine change little."""
    threads = pathlib.Path(f"/proc/{server.pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9


def main():
    program = sys.argv[1]
    options = ["--log", "off", "--memory-bytes", "8GiB"]
    servers = [
        subprocess.Popen([program, "--listen", f"{HOST}:{port}", "--max-work", str(most), *options])
        for port, most in ((PORT, 1), (FREE, 10**18))
    ]
    costs = []
    try:
        time.sleep(1)
        for name, (path, request, *counted) in KINDS.items():
            text = json.dumps(request)
            count = counted[0] if counted else refused(path, request)
            before = thread_seconds(servers[1])
            status, data, _ = ask(connect(FREE, timeout=300), "POST", path, text, JSON)
            seconds = thread_seconds(servers[1]) - before
            if status != 200:
                raise SystemExit(f"{name}: {status} {data[:300]}")
            costs.append(seconds * 1e9 / count)
            print(f"{name:34} {count:>14,} {seconds:8.3f} s {costs[-1]:8.3f} ns", flush=True)
    finally:
        for server in servers:
            server.terminate()
            server.wait()
    ratio = max(costs) / min(costs)
    print(f"the most expensive operation costs {ratio:.1f} times the cheapest one")
    return 1 if ratio > 16 else 0


if __name__ == "__main__":
    sys.exit(main())
