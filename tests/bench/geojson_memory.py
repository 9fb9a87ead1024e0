#!/usr/bin/env python3
"""The memory that a server takes to map 20,000 GeoJSON cells, beside the bytes of the body, with
the keys of the objects in either order.

    tests/bench/geojson_memory.py PROGRAM

The exit status is 1 if the process grows by more than three times the body.
"""

import json
import subprocess
import sys
import time

from attacks import HOST, PORT, ask, connect
from programs import JSON

WARP = {"extent": [500, 500], "p": [[100, 100], [400, 400]], "q": [[110, 100], [390, 405]]}


def peak(process):
    """The largest resident memory of a process so far, bytes."""
    with open(f"/proc/{process.pid}/status") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))


def cell(number):
    x, y = number * 37 % 480 + 5, number * 91 % 480 + 5
    ring = [[x + 3 * (k * 7 % 5) / 5, y + 3 * (k * 3 % 5) / 5] for k in range(40)]
    geometry = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
    return {"type": "Feature", "geometry": geometry, "properties": {"number": number}}


def backwards(value):
    """The same object with its keys in the other order."""
    return dict(reversed(value.items()))


def growth(program, order):
    """By how much a new server grows, as a share of the body."""
    cells = [order(cell(number)) for number in range(20_000)]
    collection = order({"type": "FeatureCollection", "features": cells})
    body = json.dumps(order({**WARP, "geojson": collection})).encode()
    server = subprocess.Popen([program, "--listen", f"{HOST}:{PORT}", "--log", "off"])
    try:
        time.sleep(1)
        connection = connect(PORT, timeout=100)
        ask(connection, "POST", "/points", json.dumps({**WARP, "points": [[1, 2]]}), JSON)
        before = peak(server)
        status, answer, _ = ask(connection, "POST", "/points", body, JSON)
        if status != 200:
            raise SystemExit(f"not mapped: {status} {answer[:300]}")
        return (peak(server) - before) / len(body)
    finally:
        server.terminate()
        server.wait()


def main():
    worst = 0.0
    for name, order in (("as written", dict), ("backwards", backwards)):
        share = growth(sys.argv[1], order)
        worst = max(worst, share)
        print(f"keys {name}: grows by {share:.2f} of the body", flush=True)
    return 1 if worst > 3 else 0


if __name__ == "__main__":
    sys.exit(main())
