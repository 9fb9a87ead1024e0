"""Programs that run on the machine beside the containers; the caller ends them."""

import contextlib
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

from commands import ROOT, Failure, free_port, where
from drag_clients import Server
from stack import metric

READY_SECONDS = 20.0
TICKS = os.sysconf("SC_CLK_TCK")


class Process:
    """A program that runs, its output in a file."""

    def __init__(self, name, scratch, command, **environment):
        self.name, self.log = name, scratch / f"{name}.log"
        with open(self.log, "wb") as out:
            self.process = subprocess.Popen(
                [str(c) for c in command],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                cwd=scratch,
                env={
                    **{k: v for k, v in os.environ.items() if not k.startswith("MLSWARP_")},
                    **environment,
                },
            )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end(signal.SIGTERM)

    def end(self, number):
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def processor_seconds(self):
        """Processor time of the program and its children."""
        total = 0.0
        for pid in (self.process.pid, *self._children()):
            with contextlib.suppress(OSError):
                fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                total += (int(fields[11]) + int(fields[12])) / TICKS
        return total

    def _children(self):
        return (
            Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        )

    def resident(self):
        """Bytes of memory."""
        lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmRSS:")).split()[1]) * 1024

    def wait(self, works, what):
        """Waits until `works()` succeeds; it may raise connection errors."""
        deadline = time.monotonic() + READY_SECONDS
        while True:
            with contextlib.suppress(OSError):
                if works():
                    return
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise Failure(
                    f"{self.name}: {what} did not come:\n"
                    f"{self.log.read_text(errors='replace')[-3000:]}"
                )
            time.sleep(0.002)


def replica(name, stage, address, port=8080, **environment):
    """The program of the image, ready."""
    started = Process(
        name,
        stage.scratch,
        [stage.program],
        MLSWARP_LISTEN=f"{address}:{port}",
        MLSWARP_LOG="warn",
        **environment,
    )
    server = Server(address, port)
    started.wait(lambda: server.ask("GET", "/readyz")[0] == 200, "readiness")
    return started


def redis(stage):
    """(process, address for `--store`) of a shared store."""
    port = free_port()
    command = [
        where("redis-server"),
        "--port",
        port,
        "--bind",
        "127.0.0.1",
        "--save",
        "",
        "--dir",
        stage.scratch,
    ]
    started = Process("redis", stage.scratch, command)
    started.wait(
        lambda: socket.create_connection(("127.0.0.1", port), timeout=1).close() is None,
        "a connection",
    )
    return started, f"redis://127.0.0.1:{port}"


def haproxy(stage, names, address, replicas):
    """deploy/haproxy/haproxy.cfg unchanged, ready with this number of replicas."""
    started = Process(
        "haproxy", stage.scratch, [where("haproxy"), "-f", ROOT / "deploy/haproxy/haproxy.cfg"],
        PROXY_LISTEN=f"{address}:8080", PROXY_METRICS_LISTEN=f"{address}:8404",
        PROXY_REPLICAS="mlswarp:8080", PROXY_DNS=f"{names.server}:53",
    )  # fmt: skip
    figures = Server(address, 8404)
    started.wait(
        lambda: metric(figures, "haproxy_backend_active_servers", 'proxy="sessions"') == replicas,
        f"{replicas} replicas",
    )
    return started
