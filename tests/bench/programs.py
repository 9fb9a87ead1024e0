#!/usr/bin/env python3
"""Compares two release builds of the program over HTTP, request by request in turns.

    tests/bench/programs.py OLD NEW [PAIRS]

Prints the 10th percentile and the median of both in milliseconds, their ratios (new / old), and how
many responses were equal byte for byte. Both programs, and this one, share the machine: only the
ratios of one run mean something.
"""

import contextlib
import http.client
import json
import pathlib
import random
import subprocess
import sys
import time
import uuid

PHOTO = (pathlib.Path(__file__).parent.parent / "images" / "astronaut.png").read_bytes()
HANDLES = [[x * 90 + 40, y * 90 + 40] for y in range(3) for x in range(4)]
JSON = {"Content-Type": "application/json"}
WARM_UP = 20


class Program:
    """A running program and one connection to it."""

    def __init__(self, path, port):
        self.process = subprocess.Popen([path, "--listen", f"127.0.0.1:{port}", "--log", "off"])
        self.connection = http.client.HTTPConnection("127.0.0.1", port)
        for _ in range(200):
            try:
                self.ask("GET", "/readyz", None, {})
                break
            except OSError:
                self.connection.close()
                time.sleep(0.02)
        self.session = json.loads(self.ask("POST", "/sessions", *multipart({"p": HANDLES}))[1])[
            "id"
        ]

    def ask(self, method, path, body, headers):
        """The seconds until the whole response has arrived, and its body."""
        began = time.perf_counter()
        self.connection.request(method, path, body, headers)
        response = self.connection.getresponse()
        data = response.read()
        seconds = time.perf_counter() - began
        if response.status >= 300:
            raise RuntimeError(f"{method} {path}: {response.status} {data[:300]}")
        return seconds, data

    def drag(self, pose, route="warp", headers=JSON, **output):
        body = {"q": pose} | ({"output": output} if output else {})
        return self.ask("POST", f"/sessions/{self.session}/{route}", json.dumps(body), headers)


@contextlib.contextmanager
def running(*paths):
    """Programs that end with the block, on ports of their own."""
    programs = []
    try:
        for k, path in enumerate(paths):
            programs.append(Program(path, 18181 + k))
        yield programs
    finally:
        for program in programs:
            program.process.terminate()
            program.process.wait()


def multipart(warp):
    boundary = uuid.uuid4().hex
    parts = [("image", PHOTO), ("warp", json.dumps(warp).encode())]
    head = '--{}\r\nContent-Disposition: form-data; name="{}"; filename="a"\r\n\r\n'
    body = b"".join(head.format(boundary, name).encode() + data + b"\r\n" for name, data in parts)
    return body + f"--{boundary}--\r\n".encode(), {
        "Content-Type": f"multipart/form-data; boundary={boundary}"
    }


def pose(i):
    return [
        [x + (i * 7 + n) % 23 - 11, y + (i * 5 + n) % 19 - 9] for n, (x, y) in enumerate(HANDLES)
    ]


def main():
    old, new, *pairs = sys.argv[1:]
    pairs = int(pairs[0]) if pairs else 300
    requests = {
        "drag 500 x 500 PNG": (pairs, lambda program, i: program.drag(pose(i))),
        "drag width 1920": (pairs // 4, lambda program, i: program.drag(pose(i), width=1920)),
        "drag JPEG": (pairs, lambda program, i: program.drag(pose(i), format="jpeg")),
        "mesh": (
            pairs,
            lambda program, i: program.drag(
                pose(i), "mesh", JSON | {"Accept": "application/octet-stream"}
            ),
        ),
        "POST /warp": (
            pairs // 2,
            lambda program, i: program.ask(
                "POST", "/warp", *multipart({"p": HANDLES, "q": pose(i)})
            ),
        ),
        "GET /healthz": (pairs, lambda program, i: program.ask("GET", "/healthz", None, {})),
    }
    with running(old, new) as programs:
        for name, (count, request) in requests.items():
            times, equal = ([], []), 0
            for i in range(count + WARM_UP):
                answers = {}
                for k in random.sample([0, 1], 2):
                    seconds, answers[k] = request(programs[k], i)
                    if i >= WARM_UP:
                        times[k].append(seconds * 1e3)
                equal += answers[0] == answers[1]
            at = [[sorted(t)[int(len(t) * share)] for t in times] for share in (0.1, 0.5)]
            figures = "  ".join(f"{a:.3f} {b:.3f} ms, ratio {b / a:.3f}" for a, b in at)
            print(
                f"{name:18} {count:4} pairs: p10 and median {figures}; equal {equal} of "
                f"{count + WARM_UP}",
                flush=True,
            )


if __name__ == "__main__":
    main()
