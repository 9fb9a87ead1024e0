#!/usr/bin/env python3
"""What hostile clients cost an innocent one: its response times beside each kind of attack, and
without it.

    tests/bench/attacks.py PROGRAM [NAME ...]      names select attacks; needs curl

Two servers run. Four innocent clients, processes of their own, drag a session of each in turns,
every 30 ms: the attacked server, and the other one, whose times show what the load of the machine
costs. Attackers are processes with other addresses of the loopback. Clients stand for other
machines, but share the processors with the servers: so the innocent ones run as soon as an answer
is there (real-time priority, where the system allows it), and attackers at the lowest priority.
Each of their connections sends over a link of 1 Gbit/s: without that, they send 20 Gbit/s over the
loopback, and what is measured is the kernel that copies it.

Spells without and with the attack take turns, so that both see the same machine: four of each,
2.5 seconds long. Between them the server finishes what the attack has left. Prints p50 and p99 of
all calm and of all attacked spells in milliseconds and the ratio of p99; in brackets the least and
the largest ratio of a spell and the one before it. The first lines show the same beside one and two
processes that only compute, which no server can prevent. The exit status is 1 if the ratio of an
attack exceeds two.
"""

import contextlib
import http.client
import itertools
import json
import multiprocessing
import os
import pathlib
import random
import socket
import struct
import subprocess
import sys
import time
import zlib

from programs import JSON, PHOTO

SPELL, START, ROUNDS = 2.5, 0.5, 4
INNOCENT = 4
HOST, PORT, CONTROL = "127.0.0.1", 18191, 18192
# What an attacking connection sends at most, bytes a second.
LINK = 125_000_000
SO_MAX_PACING_RATE = 47
MANY = [[(k * 37) % 4999 / 10 + 0.1, (k * 91) % 4987 / 10 + 0.2] for k in range(10_000)]


def linked(address):
    """A socket from this address over its link."""
    opened = socket.create_connection((HOST, PORT), 20, source_address=(address, 0))
    opened.setsockopt(socket.SOL_SOCKET, SO_MAX_PACING_RATE, LINK)
    return opened


def connect(port, address="127.0.0.1", timeout=20):
    return http.client.HTTPConnection(HOST, port, timeout=timeout, source_address=(address, 0))


def ask(connection, method, path, body=None, headers=None):
    connection.request(method, path, body, headers or {})
    response = connection.getresponse()
    return response.status, response.read(), response.headers


def parts(fields):
    """A multipart body of these (name, bytes)."""
    boundary = f"attack{random.getrandbits(64):016x}"
    head = '--{}\r\nContent-Disposition: form-data; name="{}"; filename="a"\r\n\r\n'
    body = b"".join(head.format(boundary, name).encode() + data + b"\r\n" for name, data in fields)
    return body + f"--{boundary}--\r\n".encode(), {
        "Content-Type": f"multipart/form-data; boundary={boundary}"
    }


def png(width, height, colour, depth, channels):
    """A picture of one value; small files of many pixels."""
    chunk = lambda kind, data: (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    )
    row = b"\0" + bytes([120]) * (width * channels * depth // 8)
    deflate = zlib.compressobj(1)
    data = b"".join(deflate.compress(row) for _ in range(height)) + deflate.flush()
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def as_soon_as_possible(client):
    """This client, in a process that does not wait for the processor."""

    def run(*arguments):
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        client(*arguments)

    return run


def at_lowest_priority(attack):
    """This attack, in a process that takes what the others leave of the processor."""

    def run(*arguments):
        os.nice(19)
        attack(*arguments)

    return run


def leave(address, method, path, body, headers, after):
    """Sends a request and leaves."""
    connection = connect(PORT, address)
    connection.sock = linked(address)
    connection.request(method, path, body, headers)
    time.sleep(after)
    connection.close()


def session(port, warp, image=PHOTO, address="127.0.0.1"):
    body, headers = parts([("image", image), ("warp", json.dumps(warp).encode())])
    status, data, _ = ask(connect(port, address, 120), "POST", "/sessions", body, headers)
    if status != 201:
        raise SystemExit(f"no session: {status} {data[:300]}")
    return json.loads(data)["id"]


def repeat(end, address, method, path, body=None, headers=None):
    connection = connect(PORT, address)
    while time.time() < end:
        try:
            connection.sock = connection.sock or linked(address)
            ask(connection, method, path, body, headers)
        except (OSError, http.client.HTTPException):
            connection = connect(PORT, address)


# Each attack returns a list of functions of the time of its end, one for each attacking process,
# and is prepared before the clock starts.


def landmarks_cr():
    rows = b"mapX,mapY,sourceX,sourceY,enable\r" + b"0,0,0,0,0\r" * 400_000
    return [
        lambda end, a=a: repeat(end, f"127.0.1.{a}", "POST", "/landmarks", rows, {})
        for a in range(4)
    ]


def head_session():
    large = session(PORT, {"p": MANY, "grid": {"columns": 2, "rows": 2}})
    return [
        lambda end, a=a: repeat(end, "127.0.1.1", "HEAD", f"/sessions/{large}") for a in range(8)
    ]


def plan_not_modified():
    large = session(PORT, {"p": MANY, "grid": {"columns": 2, "rows": 2}})
    path = f"/sessions/{large}/plan?columns=2&rows=2"
    _, _, headers = ask(connect(PORT), "GET", path)
    tag = {"If-None-Match": headers.get("etag", '"x"')}
    return [lambda end: repeat(end, "127.0.1.1", "GET", path, None, tag) for _ in range(8)]


def head_plan():
    large = session(PORT, {"p": MANY[:500]})
    return [
        lambda end: repeat(end, "127.0.1.1", "HEAD", f"/sessions/{large}/plan?columns=100&rows=100")
        for _ in range(8)
    ]


def batch_annotations():
    one = session(PORT, {"p": [[100, 100], [300, 300]]})
    foreign = "[" + ",".join("0" * 1_900_000) + "]"
    point = {"type": "Point", "coordinates": [1, 2]}
    feature = json.dumps({"type": "Feature", "properties": {}, "geometry": point})
    geojson = f'{{"type":"FeatureCollection","features":[{feature}],"x":{foreign}}}'
    body = f'{{"q":[[110,100],[300,310]],"steps":2,"geojson":{geojson}}}'

    def attack(end):
        held = []
        while time.time() < end:
            # The answer is not read.
            s = linked("127.0.1.1")
            head = (
                f"POST /sessions/{one}/batch HTTP/1.1\r\nHost: {HOST}\r\nContent-Type: "
                f"application/json\r\nContent-Length: {len(body)}\r\n\r\n"
            )
            with contextlib.suppress(OSError):
                s.sendall(head.encode() + body.encode())
            held = held[-40:] + [s]

    return [attack, attack]


def inverse_and_leave():
    q = [[x + (k * 13) % 400 - 200, y + (k * 29) % 400 - 200] for k, (x, y) in enumerate(MANY)]
    points = [[(k * 17) % 5000 / 10, (k * 31) % 5000 / 10] for k in range(20_000)]
    warp = {"extent": [500, 500], "p": MANY, "q": q, "points": points, "inverse": True}
    body = json.dumps(warp)

    def attack(end, address):
        while time.time() < end:
            leave(address, "POST", "/points", body, JSON, 0.2)

    return [lambda end, a=a: attack(end, f"127.0.1.{a}") for a in range(3)]


def labels_and_leave():
    image = png(5000, 5000, 0, 8, 1)
    one = session(PORT, {"p": [[100, 100], [300, 300]]}, image)
    layer = png(5000, 5000, 6, 16, 4)

    def attack(end):
        while time.time() < end:
            leave("127.0.1.1", "PUT", f"/sessions/{one}/layers/a?kind=labels", layer, {}, 0.3)

    return [attack, attack]


def spline_sessions():
    points = [[x * 11 + (y % 3), y * 10 + (x % 2)] for x in range(40) for y in range(40)]
    ids = [session(PORT, {"p": points, "method": "tps", "smoothing": k / 10}) for k in range(6)]

    def attack(end, first):
        connection, k = connect(PORT, "127.0.1.1", 60), first
        while time.time() < end:
            ask(connection, "GET", f"/sessions/{ids[k % 6]}")
            k += 1

    return [lambda end, k=k: attack(end, k) for k in range(4)]


def report_of_pixels():
    body = json.dumps(
        {"extent": [7000, 7000], "grid": "pixel", "p": [[1, 1], [9, 9]], "q": [[2, 1], [9, 8]]}
    )
    return [
        lambda end, a=a: repeat(end, f"127.0.1.{a % 3}", "POST", "/report", body, JSON)
        for a in range(6)
    ]


def fit_that_never_ends():
    points = [[x * 11 + (y % 3), y * 10 + (x % 2)] for x in range(44) for y in range(44)]
    q = [[x + 1, y] for x, y in points]
    candidates = [{"method": "tps", "smoothing": k / 100} for k in range(64)]
    body = json.dumps({"extent": [500, 500], "p": points, "q": q, "candidates": candidates})

    def attack(end, address):
        while time.time() < end:
            leave(address, "POST", "/fit", body, JSON, 1)

    return [lambda end, a=a: attack(end, f"127.0.1.{a}") for a in range(3)]


def region_fit():
    image, mask = png(5000, 5000, 2, 8, 3), png(5000, 5000, 6, 8, 4)
    body, headers = parts(
        [
            ("image", image),
            ("region", mask),
            ("warp", json.dumps({"p": [[100, 100], [300, 300]]}).encode()),
        ]
    )
    one = json.loads(ask(connect(PORT, "127.0.1.1", 60), "POST", "/sessions", body, headers)[1])[
        "id"
    ]
    drag = json.dumps({"q": [[110, 100], [300, 310]], "output": {"canvas": "fit", "width": 16}})
    return [
        lambda end: repeat(end, "127.0.1.1", "POST", f"/sessions/{one}/warp", drag, JSON)
        for _ in range(4)
    ]


def large_drags():
    one = session(PORT, {"p": MANY, "grid": {"columns": 2, "rows": 2}})
    drag = json.dumps({"q": [[0, 0]] * 110_001})
    return [
        lambda end: repeat(end, "127.0.1.1", "POST", f"/sessions/{one}/warp", drag, JSON)
        for _ in range(4)
    ]


def webp_and_leave():
    image = png(7000, 7000, 2, 8, 3)
    one = session(PORT, {"p": [[100, 100], [300, 300]]}, image)
    drag = json.dumps({"q": [[150, 100], [300, 350]], "output": {"format": "webp"}})

    def attack(end, address):
        while time.time() < end:
            leave(address, "POST", f"/sessions/{one}/warp", drag, JSON, 0.5)

    return [lambda end, a=a: attack(end, f"127.0.1.{a}") for a in range(3)]


def http2_streams():
    one = session(PORT, {"p": MANY[:200]})
    url = f"http://{HOST}:{PORT}/sessions/{one}/plan?columns=40&rows=40&x=[1-300]"
    command = [
        "curl",
        "-sZ",
        "--parallel-max",
        "200",
        "--http2-prior-knowledge",
        "--interface",
        "127.0.1.1",
        "-o",
        os.devnull,
        url,
    ]

    def attack(end):
        while time.time() < end:
            try:
                subprocess.run(
                    command,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    timeout=max(0.1, end - time.time()),
                )
            except subprocess.TimeoutExpired:
                return

    return [attack] * 3


ATTACKS = {
    "landmark rows that end in CR, 4 addresses": landmarks_cr,
    "HEAD of a session of 10,000 handles": head_session,
    "GET of a plan, not modified": plan_not_modified,
    "HEAD of a plan": head_plan,
    "annotations of batches, unread": batch_annotations,
    "inverse points, 3 addresses that leave": inverse_and_leave,
    "labels of 25 MP, clients that leave": labels_and_leave,
    "sessions of large splines in turn": spline_sessions,
    "reports of 49 MP by pixel, 3 addresses": report_of_pixels,
    "fits that cannot end, 3 addresses that leave": fit_that_never_ends,
    "drags with a region and canvas fit": region_fit,
    "drags of 110,001 handles": large_drags,
    "WebP of 49 MP, 3 addresses that leave": webp_and_leave,
    "HTTP/2 streams, unreset": http2_streams,
}


def burn(end):
    """A foreign load of one processor, at the niceness of the server: what the machine itself
    costs."""
    while time.time() < end:
        pass


# What the innocent clients are measured beside, and is no attack.
LOADS = {f"no attack, {n} busy processor{'s'[: n - 1]}": (lambda n=n: [burn] * n) for n in (1, 2)}


def innocent(end, times):
    """Drags a session of each server in turns; puts the list of (began, ms) of each."""
    targets = []
    for port in (PORT, CONTROL):
        targets.append(
            (connect(port), session(port, {"p": [[100, 100], [300, 300], [200, 400]]}), [])
        )
    while time.time() < end.value:
        for connection, id_, own in targets:
            x = random.uniform(-20, 20)
            body = json.dumps(
                {
                    "q": [[100 + x, 100], [300, 300 - x], [200, 400]],
                    "output": {"format": "jpeg", "width": 200},
                }
            )
            at, began = time.time(), time.perf_counter()
            status, _, _ = ask(connection, "POST", f"/sessions/{id_}/warp", body, JSON)
            own.append((at, (time.perf_counter() - began) * 1e3 if status == 200 else 60_000.0))
        time.sleep(0.03)
    times.put([own for *_, own in targets])


def percentiles(times):
    times = sorted(times)
    return times[len(times) // 2], times[min(len(times) - 1, len(times) * 99 // 100)]


def processor_seconds(server):
    fields = pathlib.Path(f"/proc/{server.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def settle(server):
    """Waits until what the last attack has left is done: four clients cost far less than this."""
    for _ in range(40):
        before = processor_seconds(server)
        time.sleep(0.25)
        if processor_seconds(server) - before < 0.12:
            return


def spells_beside(server, attackers):
    """Spells (began, ended): calm and attacked ones in turns."""
    calm, attacked = [], []
    for _ in range(ROUNDS):
        settle(server)
        began = time.time()
        time.sleep(SPELL)
        calm.append((began, time.time()))
        until = time.time() + START + SPELL
        processes = [
            multiprocessing.Process(
                target=attack if attack is burn else at_lowest_priority(attack),
                args=(until,),
                daemon=True,
            )
            for attack in attackers
        ]
        for process in processes:
            process.start()
        time.sleep(START)
        began = time.time()
        time.sleep(max(0.0, until - began))
        attacked.append((began, time.time()))
        for process in processes:
            # It ends by itself with what it has started.
            process.join(2)
            process.kill()
    return calm, attacked


def measure(server, attackers, client, count):
    """The response times of `count` of this client, for the attacked server and for the other one:
    those of each calm and each attacked spell."""
    end, times = multiprocessing.Value("d", time.time() + 600), multiprocessing.Queue()
    run = as_soon_as_possible(client)
    clients = [multiprocessing.Process(target=run, args=(end, times)) for _ in range(count)]
    for process in clients:
        process.start()
    time.sleep(1)
    kinds = spells_beside(server, attackers)
    end.value = 0
    result = [times.get(timeout=180) for _ in clients]
    for process in clients:
        process.join()
    return [
        [
            [
                [ms for own in lists for at, ms in own if began <= at < ended]
                for began, ended in kind
            ]
            for kind in kinds
        ]
        for lists in zip(*result)
    ]


def line(name, calm, attacked):
    """The p50 and p99 of all spells of a kind together, and the ratio of these; the least and the
    largest ratio of a spell and the one before it."""
    (c50, c99), (a50, a99) = (percentiles(itertools.chain(*kind)) for kind in (calm, attacked))
    ratios = [percentiles(a)[1] / percentiles(c)[1] for c, a in zip(calm, attacked)]
    print(
        f"{name:46} calm {c50:5.1f} {c99:6.1f}   beside {a50:5.1f} {a99:6.1f}   ratio "
        f"{a99 / c99:5.2f} ({min(ratios):.1f} to {max(ratios):.1f})",
        flush=True,
    )
    return a99 / c99


def compare(attacks, client, count, options=()):
    """Prints a line for each of the attacks on the program of the command line, of those that its
    other arguments select. The exit status."""
    multiprocessing.set_start_method("fork")
    program, *names = sys.argv[1:]
    servers = [
        subprocess.Popen([program, "--listen", f"{HOST}:{port}", "--log", "off", *options])
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
        for name, prepare in (LOADS | attacks).items():
            if name in LOADS or not names or any(wanted in name for wanted in names):
                attacked, other = measure(servers[0], prepare(), client, count)
                ratio = line(name, *attacked)
                line("    the other server", *other)
                worst = max(worst, ratio if name in attacks else 0.0)
    finally:
        for server in servers:
            server.terminate()
            server.wait()
    return 1 if worst > 2 else 0


if __name__ == "__main__":
    sys.exit(compare(ATTACKS, innocent, INNOCENT))
