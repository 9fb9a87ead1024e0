"""Tests deploy/nginx/nginx.conf: its syntax, and drags through it while a replica is killed."""

import json
import re
import signal
from contextlib import ExitStack

from commands import AS_ROOT, ROOT, run, where
from drag_clients import RequestClient, Server, SocketClient, multipart
from names import Names
from processes import Process, redis, replica

FILE = ROOT / "deploy" / "nginx" / "nginx.conf"


def derived(stage, listen, replicas):
    """The file with the addresses of this test, and writable directories."""
    text = FILE.read_text()
    for old, new, times in (
        (r"listen 127\.0\.0\.1:8080", lambda _: f"listen {listen}", 1),
        (
            r"(?:( +)server 127\.0\.0\.1:\d+ (.*)\n)+",
            lambda line: "".join(f"{line[1]}server {r} {line[2]}\n" for r in replicas),
            2,
        ),
    ):
        text, found = re.subn(old, new, text)
        if found != times:
            raise AssertionError(f"nginx.conf has `{old}` {found} times, not {times}")
    place = stage.scratch / "nginx.conf"
    temporary = "".join(
        f"{kind}_temp_path {stage.scratch}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    place.write_text(
        text.replace("pid /tmp/nginx.pid", f"pid {stage.scratch}/nginx.pid").replace(
            "http {\n", "http {\n" + temporary
        )
    )
    return place


def check_nginx(stage):
    check, nginx = stage.check, where("nginx")
    said = run(*AS_ROOT, nginx, "-t", "-c", FILE, check=False)
    check(
        "nginx takes its file",
        said.returncode == 0,
        said.stderr.decode(errors="replace").splitlines()[-1:],
    )
    with ExitStack() as running:
        names = running.enter_context(Names())
        front, (shared, store) = Server(names.address(3), 8080), redis(stage)
        running.enter_context(shared)
        addresses = [names.address(n) for n in (11, 12)]
        store = {"MLSWARP_STORE": store, "MLSWARP_TRUSTED_PROXIES": "127.0.0.0/8"}
        replicas = {
            a: running.enter_context(replica(f"replica-{a}", stage, a, **store)) for a in addresses
        }
        lone = replica("lone", stage, names.address(21))
        running.enter_context(lone)
        place = derived(stage, f"{front.host}:8080", [f"{a}:8080" for a in addresses])
        server = Process(
            "nginx", stage.scratch, [nginx, "-e", "stderr", "-c", place, "-g", "daemon off;"]
        )
        running.enter_context(server)
        server.wait(lambda: front.ask("GET", "/readyz")[0] == 200, "an answer")

        # Enough sessions for both replicas.
        clients = [RequestClient(f"client {i}", "chelsea.png", i / 50) for i in range(6)]
        for client in clients:
            client.learn(Server(names.address(21), 8080))
            client.put(front)
        once = [client.once(front) for client in clients for _ in range(3)]
        check(
            "nginx: pictures come through it and are right",
            all(status == 200 and right for status, right, _ in once),
            len(once),
        )
        plans = [plan for _, _, plan in once]
        check(
            "nginx: upload and drags come to one replica",
            "built" not in plans,
            f"{plans.count('built')} built for {len(clients)} sessions",
        )
        body, kind = multipart(clients[0].file, {"p": clients[0].rest})
        status, headers, _ = front.ask("POST", "/sessions", body, kind)
        check(
            "nginx: an upload without an id comes through it",
            status == 201 and bool(headers["Location"]),
            status,
        )
        status, headers, _ = front.ask("GET", f"/{'x' * 9000}")
        check(
            "nginx: what it refuses itself is a problem document",
            (status, headers["Content-Type"]) == (400, "application/problem+json"),
            status,
        )
        status, _, _ = front.ask("GET", "/metrics")
        check("nginx: the figures of replicas are not for everybody", status == 404, status)

        socket = SocketClient("socket", "coffee.png", 0.05)
        socket.learn(Server(names.address(21), 8080))
        socket.put(front)
        frame, right = socket.once(front)
        check("nginx: a drag socket goes through it", right, f"{len(frame)} bytes")

        replicas[addresses[0]].end(signal.SIGKILL)
        twice = [client.once(front) for client in clients for _ in range(3)]
        check(
            "nginx: with a replica killed nobody is refused",
            all(status == 200 and right for status, right, _ in twice),
            [s for s, _, _ in twice],
        )
        replicas[addresses[1]].end(signal.SIGKILL)
        status, headers, body = front.ask("GET", f"/sessions/{clients[0].session}")
        code = (
            json.loads(body).get("code")
            if headers["Content-Type"] == "application/problem+json"
            else body[:80]
        )
        check(
            "nginx: with none left it says so",
            (status, headers["Retry-After"], code) == (503, "1", "unavailable"),
            f"{status} {code}",
        )
        log = server.log.read_text(errors="replace")
        told = [client.name for client in clients if client.session in log]
        check(
            "nginx: its log names no session",
            '"POST 200"' in log and not told,
            told or f"{len(log.splitlines())} lines",
        )
