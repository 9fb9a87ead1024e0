"""Retries of deploy/haproxy and deploy/nginx: test replicas that crash on requests count how many
of them a request has reached."""

import contextlib
import http.client
import json
import socket
import struct
import threading
import time
import uuid
from contextlib import ExitStack

from commands import where
from drag_clients import PATIENCE, Server
from names import Names
from nginx import derived
from processes import Process, haproxy

REPLICAS, CLIENTS, QUESTIONS, DEATHS = 4, 4, 10, 8
# Seconds for which a killed replica is down, and up again.
AWAY, BACK = 0.4, 0.6
# Pause between a head and its body, for clients that send them separately.
BREATH = 0.05
DEADLY = "whoever reads this dies"


class Replica:
    """Answers every request, unless the body is deadly: then it closes the connection without a
    response."""

    def __init__(self, address, deadly):
        self.address, self.deadly, self.lock, self.lines = address, deadly, threading.Lock(), set()

    def __enter__(self):
        self.listener = socket.create_server((self.address, 8080), backlog=64)
        threading.Thread(target=self._accept, args=(self.listener,), daemon=True).start()
        return self

    def __exit__(self, *_):
        """Like a kill: closes the listener and all connections at once; later connections are
        reset."""
        with self.lock:
            gone, self.lines = self.lines, set()
        for line in (self.listener, *gone):
            with contextlib.suppress(OSError):
                line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                # Wakes waiting threads.
                line.shutdown(socket.SHUT_RDWR)
            line.close()

    def _accept(self, listener):
        with contextlib.suppress(OSError):
            while True:
                line, _ = listener.accept()
                with self.lock:
                    self.lines.add(line)
                threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line):
        with contextlib.suppress(OSError, ValueError), line, line.makefile("rb") as reader:
            while reader.readline():
                length = 0
                while header := reader.readline().strip():
                    name, _, value = header.partition(b":")
                    length = int(value) if name.lower() == b"content-length" else length
                if self.deadly(self.address, reader.read(length)):
                    break
                # Long enough for a kill to interrupt some.
                time.sleep(0.002)
                line.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")
        with self.lock:
            self.lines.discard(line)


def pose(front, body):
    """(status, headers, body) of a request for a new session on a new connection; the body is sent
    after the head."""
    connection = http.client.HTTPConnection(front.host, front.port, timeout=PATIENCE)
    connection.putrequest("POST", f"/sessions/{uuid.uuid4()}/warp")
    connection.putheader("Content-Type", "application/json")
    connection.putheader("Content-Length", str(len(body)))
    connection.endheaders()
    time.sleep(BREATH)
    connection.send(body)
    answer = connection.getresponse()
    with contextlib.closing(connection):
        return answer.status, answer.headers, answer.read()


def question(more):
    return json.dumps({"q": more, "number": str(uuid.uuid4())}).encode()


def check_retries(stage):
    # The replicas that each deadly body has reached.
    met, lock = {}, threading.Lock()

    def deadly(address, body):
        with lock:
            before = met.setdefault(body, [])
            before.append(address)
        return DEADLY.encode() in body or b"once" in body and len(before) == 1

    with ExitStack() as running:
        names = running.enter_context(Names())
        names.addresses["mlswarp"] = [names.address(11 + i) for i in range(REPLICAS)]
        replicas = [
            running.enter_context(Replica(address, deadly))
            for address in names.addresses["mlswarp"]
        ]
        running.enter_context(haproxy(stage, names, names.address(3), REPLICAS))
        front = Server(names.address(3), 8080)
        check_deadly(stage.check, front, met)
        check_kills(stage.check, front, replicas)
        check_nginx(stage, names, met)


def check_deadly(check, front, met):
    unlike = []
    for _ in range(QUESTIONS):
        body = question(DEADLY)
        status, headers, said = pose(front, body)
        problem = json.loads(said)
        told = (
            status,
            headers["Content-Type"],
            headers["Retry-After"],
            problem["status"],
            problem["code"],
        )
        # Not `unavailable`, which clients retry automatically.
        if (
            told != (502, "application/problem+json", "1", 502, "internal")
            or len(set(met[body])) != 2
            or len(met[body]) != 2
        ):
            unlike.append((told, met[body]))
    check(
        "retries: a request over which replicas die is sent to two of them, and refused",
        not unlike,
        unlike[:2] or f"{QUESTIONS} of them",
    )
    answers = [pose(front, question("once")) for _ in range(QUESTIONS)]
    refused = [answer[:1] + answer[2:] for answer in answers if answer[0] != 200]
    check(
        "retries: what one replica has not answered is answered by another",
        not refused,
        refused[:2] or f"{QUESTIONS} of them",
    )


def check_nginx(stage, names, met):
    front = Server(names.address(4), 8080)
    place = derived(
        stage, f"{front.host}:8080", [f"{address}:8080" for address in names.addresses["mlswarp"]]
    )
    with Process(
        "nginx", stage.scratch, [where("nginx"), "-e", "stderr", "-c", place, "-g", "daemon off;"]
    ) as server:
        server.wait(lambda: front.ask("GET", "/")[0] == 200, "an answer")
        # All on one connection, so by one worker, which might keep its upstream connections.
        for _ in range(8 * REPLICAS):
            front.ask("POST", f"/sessions/{uuid.uuid4()}/warp", question([]))
        body = question(DEADLY)
        status, headers, _ = front.ask("POST", f"/sessions/{uuid.uuid4()}/warp", body)
        right = (status, headers["Retry-After"]) == (502, "1") and len(met[body]) == len(
            set(met[body])
        ) == 2
        stage.check(
            "retries: nginx sends a request over which replicas die to two of them",
            right,
            (status, met[body]),
        )


def check_kills(check, front, replicas):
    """Clients send requests without pause while replicas stop and start."""
    refused, answered, stop = [], [], threading.Event()

    def ask():
        while not stop.is_set():
            try:
                status, _, said = front.ask("POST", f"/sessions/{uuid.uuid4()}/warp", question([]))
                (answered if status == 200 else refused).append((status, said))
            except (OSError, http.client.HTTPException) as error:
                refused.append(repr(error))

    threads = [threading.Thread(target=ask) for _ in range(CLIENTS)]
    for thread in threads:
        thread.start()
    try:
        for number in range(DEATHS):
            victim = replicas[number % len(replicas)]
            victim.__exit__()
            time.sleep(AWAY)
            victim.__enter__()
            time.sleep(BACK)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    check(
        f"retries: nobody notices that replicas are killed, {DEATHS} times",
        answered and not refused,
        refused[:3] or f"{len(answered)} answers",
    )
