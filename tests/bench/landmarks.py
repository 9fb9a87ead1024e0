#!/usr/bin/env python3
"""Compares how two release builds of the program pose many landmarks: a photograph of 512 x 512 px
with the default grid, requests in turns.

    tests/bench/landmarks.py OLD NEW [PAIRS]

The landmarks lie in 180 x 220 px, on a shaken lattice or at random places, and move in waves of
4 px or each by up to a quarter of their distance, as in `cargo bench --bench request`. The time is
that of the stage `deform` in `Server-Timing`, ms; of the first picture it is that of `plan` and
`deform`. Both programs share the machine: only the ratios of one run (old / new) mean something.
"""

import json
import math
import random
import statistics
import sys

from programs import JSON, multipart, running

WIDTH, HEIGHT, LEFT, TOP = 180, 220, 160, 140
COUNTS = (68, 106, 478, 1000)
KINDS = {
    "evenly, waves": (True, True),
    "at random, waves": (False, True),
    "evenly, each for itself": (True, False),
}
SETS = [("rigid", kind, count) for kind in KINDS for count in COUNTS]
SETS += [("tps", "evenly, waves", count) for count in COUNTS[2:]]


def landmarks(count, is_even):
    columns = math.ceil(math.sqrt(count * WIDTH / HEIGHT))
    rows = math.ceil(count / columns)
    shaken = random.Random(count)

    def share(k):
        x, y = shaken.random(), shaken.random()
        if is_even:
            x = (k % columns + 0.35 + 0.3 * x) / columns
            y = (k // columns + 0.35 + 0.3 * y) / rows
        return x, y

    shares = [share(k) for k in range(count)]
    return [[LEFT + WIDTH * x, TOP + HEIGHT * y] for x, y in shares]


def moved(p, number, is_smooth):
    if is_smooth:
        time = 0.1 * number
        return [[x + 4 * math.sin(y / 30 + time), y + 4 * math.cos(x / 35 + time)] for x, y in p]
    step = 0.25 * math.sqrt(WIDTH * HEIGHT / len(p))
    own = random.Random(number)
    return [[x + own.uniform(-step, step), y + own.uniform(-step, step)] for x, y in p]


def drag(program, session, q):
    """The seconds of each stage of a drag, by `Server-Timing`."""
    connection = program.connection
    connection.request("POST", f"/sessions/{session}/warp", json.dumps({"q": q}), JSON)
    response = connection.getresponse()
    body = response.read()
    if response.status >= 300:
        raise RuntimeError(f"{response.status} {body[:300]}")
    stages = response.getheader("Server-Timing").split(", ")
    return {name: float(time) for name, _, time in (stage.partition(";dur=") for stage in stages)}


def main():
    old, new, *pairs = sys.argv[1:]
    pairs = int(pairs[0]) if pairs else 40
    with running(old, new) as programs:
        for method, kind, count in SETS:
            is_even, is_smooth = KINDS[kind]
            p = landmarks(count, is_even)
            warp = {"p": p, "method": method}
            opened = [program.ask("POST", "/sessions", *multipart(warp))[1] for program in programs]
            sessions = [json.loads(answer)["id"] for answer in opened]
            times, firsts = ([], []), [0, 0]
            for number in range(pairs + 1):
                q = moved(p, number, is_smooth)
                for k in random.sample([0, 1], 2):
                    stages = drag(programs[k], sessions[k], q)
                    if number:
                        times[k].append(stages["deform"])
                    else:
                        firsts[k] = stages.get("plan", 0) + stages["deform"]
            of = (min(times[0]), min(times[1]), *map(statistics.median, times))
            least, median = [
                f"{a:7.2f} {b:6.2f} ms, ratio {a / b:5.2f}" for a, b in (of[:2], of[2:])
            ]
            print(
                f"{method:5} {count:4} {kind:24} pose, least {least}; median {median}; first "
                f"picture {firsts[0]:7.2f} {firsts[1]:6.2f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
