"""The time from start to readiness, and the idle memory."""

import socket
import statistics
import time

from commands import free_port, say
from processes import Process, replica

STARTS = 40
IDLE_SECONDS = 1.0
IDLE_BYTES = 15_000_000
ASK = b"GET /readyz HTTP/1.1\r\nHost: mlswarp\r\nConnection: close\r\n\r\n"


def check_start(stage):
    times = sorted(start(stage) for _ in range(STARTS))
    say(
        f"start to readiness, {STARTS} times, no store: median "
        f"{statistics.median(times) * 1000:.1f} ms, longest {times[-1] * 1000:.1f} ms"
    )
    with replica("idle", stage, "127.0.0.1", free_port()) as idle:
        time.sleep(IDLE_SECONDS)
        resident = idle.resident()
    stage.check(
        "it takes little memory while idle",
        resident < IDLE_BYTES,
        f"{resident / 1e6:.1f} MB resident",
    )


def start(stage):
    """Seconds from the start of the program to the first 200 of /readyz."""
    port = free_port()
    begun = time.monotonic()

    def ready():
        with socket.create_connection(("127.0.0.1", port), timeout=2) as asked:
            asked.sendall(ASK)
            return asked.recv(64).startswith(b"HTTP/1.1 200")

    with Process(
        "start",
        stage.scratch,
        [stage.program],
        MLSWARP_LISTEN=f"127.0.0.1:{port}",
        MLSWARP_LOG="warn",
    ) as started:
        started.wait(ready, "readiness")
        return time.monotonic() - begun
