#!/usr/bin/env python3
"""One key, eleven visitors with session tokens: ten drag, and one floods. The ten's response times
beside each kind of flood, and without it.

    tests/bench/visitors.py PROGRAM [NAME ...]      names select floods

The ten are processes of their own, each with its session and token, and drag every 100 ms; the
eleventh has a token of every operation and sends as much as it can from one address, over 16
connections. A second server (control) is not flooded: the ten drag there too, in turns, and these
times show what the load of the machine costs. Priorities are those of `attacks.py`. Each flood
lasts ten seconds. Prints p50 and p99 of the ten together in milliseconds, and the ratio of p99
beside a flood to p99 without one. The exit status is 1 if a ratio exceeds two.
"""

import http.client
import json
import multiprocessing
import random
import subprocess
import sys
import time

from attacks import CONTROL, HOST, PORT, ask, beside, connect, parts, png
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
    """Drags a session of each server in turns, and puts the lists of its response times, ms."""
    targets = [
        (connect(port), visitor(["warp", "drag"], port=port), []) for port in (PORT, CONTROL)
    ]
    time.sleep(random.random() / 10)
    while time.time() < end.value:
        for connection, (path, token), own in targets:
            x = random.uniform(-20, 20)
            q = [[100 + x, 100], [300, 300 - x], [200, 400]]
            body = json.dumps({"q": q, "output": {"format": "jpeg", "width": 200}})
            began = time.perf_counter()
            status, _, _ = ask(connection, "POST", f"{path}/warp", body, {**JSON, **token})
            own.append((time.perf_counter() - began) * 1e3 if status == 200 else 60_000.0)
        time.sleep(0.1)
    # The first builds the plan.
    times.put([own[1:] for *_, own in targets])


def measure(flooders):
    """The times of the ten beside these flooders: of the flooded server, and of the other one."""
    return beside(flooders, innocent, 10)


def main():
    program, *names = sys.argv[1:]
    options = ["--keys", f"ann {KEY}", "--log", "off"]
    servers = [
        subprocess.Popen([program, "--listen", f"{HOST}:{port}", *options])
        for port in (PORT, CONTROL)
    ]
    worst = 0.0
    try:
        for port in (PORT, CONTROL):
            for _ in range(200):
                try:
                    ask(connect(port), "GET", "/readyz")
                    break
                except OSError:
                    time.sleep(0.05)
        alone = measure([])[0]
        print(f"{'ten that drag':24} p50 {alone[0]:7.1f}  p99 {alone[1]:7.1f} ms", flush=True)
        for name, prepare in FLOODS.items():
            if names and not any(wanted in name for wanted in names):
                continue
            flooded, control = measure(prepare())
            ratio = flooded[1] / alone[1]
            worst = max(worst, ratio)
            print(
                f"beside {name:17} p50 {flooded[0]:7.1f}  p99 {flooded[1]:7.1f} ms;  "
                f"control {control[0]:6.1f} {control[1]:6.1f};  ratio {ratio:.2f}",
                flush=True,
            )
    finally:
        for server in servers:
            server.terminate()
            server.wait()
    return 1 if worst > 2 else 0


if __name__ == "__main__":
    multiprocessing.set_start_method("fork")
    sys.exit(main())
