#!/usr/bin/env python3
"""One key, eleven visitors with session tokens: ten drag, and one floods. The ten's response times
beside each kind of flood, and without it.

    tests/bench/visitors.py PROGRAM [NAME ...]      names select floods

The ten are processes of their own, each with its session and token, and drag every 100 ms; the
eleventh has a token of every operation and sends as much as it can from one address, over 16
connections. They drag on a second server too, which is not flooded. Spells, lines, priorities and
the exit status are those of `attacks.py`.
"""

import http.client
import json
import random
import sys
import time

from attacks import CONTROL, PORT, ask, compare, connect, parts, png
from programs import JSON, PHOTO

KEY = "a-key-of-the-bench-0123456789"
BEARER = {"Authorization": f"Bearer {KEY}"}
REST = [[100, 100], [300, 300], [200, 400]]
ALL = ["read", "warp", "drag", "handles", "layers", "upload", "batch", "delete"]
FLOODERS = 16


def visitor(ops, image=PHOTO, port=PORT):
    """A session of the key, and the headers of a token for it."""
    body, headers = parts([("image", image), ("warp", json.dumps({"p": REST}).encode())])
    status, data, _ = ask(
        connect(port, timeout=120), "POST", "/sessions", body, {**headers, **BEARER}
    )
    if status != 201:
        raise SystemExit(f"no session: {status} {data[:300]}")
    one = json.loads(data)["id"]
    body = json.dumps({"ops": ops, "ttl": 3600})
    _, data, _ = ask(connect(port), "POST", f"/sessions/{one}/tokens", body, {**JSON, **BEARER})
    return f"/sessions/{one}", {"Authorization": f"Bearer {json.loads(data)['token']}"}


def repeat(end, method, path, body, headers):
    connection = connect(PORT, "127.0.1.1")
    while time.time() < end:
        try:
            ask(connection, method, path, body, headers)
        except (OSError, http.client.HTTPException):
            connection = connect(PORT, "127.0.1.1")


def flood(what, body, image=PHOTO, method="POST"):
    path, token = visitor(ALL, image)
    headers = {**token, **(JSON if isinstance(body, str) else {})}
    return [lambda end: repeat(end, method, path + what, body, headers)] * FLOODERS


Q = [[x + 5, y] for x, y in REST]
FLOODS = {
    "drags": lambda: flood("/warp", json.dumps({"q": Q})),
    "drags of 25 MP": lambda: flood("/warp", json.dumps({"q": Q}), png(5000, 5000, 2, 8, 3)),
    "batches": lambda: flood("/batch", json.dumps({"q": Q, "steps": 200})),
    "fits": lambda: flood("/fit", json.dumps({"q": Q})),
    "points": lambda: flood(
        "/points", json.dumps({"q": Q, "points": [[k % 500, k % 400] for k in range(50_000)]})
    ),
    "layers of 25 MP": lambda: flood("/layers/a", png(5000, 5000, 2, 8, 3), method="PUT"),
}


def innocent(end, times):
    """Drags a session of each server in turns, and puts the list of (began, ms) of each."""
    targets = [
        (connect(port), visitor(["warp", "drag"], port=port), []) for port in (PORT, CONTROL)
    ]
    time.sleep(random.random() / 10)
    while time.time() < end.value:
        for connection, (path, token), own in targets:
            x = random.uniform(-20, 20)
            q = [[100 + x, 100], [300, 300 - x], [200, 400]]
            body = json.dumps({"q": q, "output": {"format": "jpeg", "width": 200}})
            at, began = time.time(), time.perf_counter()
            status, _, _ = ask(connection, "POST", f"{path}/warp", body, {**JSON, **token})
            own.append((at, (time.perf_counter() - began) * 1e3 if status == 200 else 60_000.0))
        time.sleep(0.1)
    times.put([own for *_, own in targets])


if __name__ == "__main__":
    sys.exit(compare(FLOODS, innocent, 10, ["--keys", f"ann {KEY}"]))
