"""The server of the tests, and requests to it with nothing but the standard library."""

import json
import os
import re
import subprocess
import time
import urllib.error
import urllib.request
import uuid
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Debian's Chromium, with WebGL by the processor, and where its screenshots are.
CHROMIUM = os.environ.get("MLSWARP_CHROMIUM", "/usr/bin/chromium-headless-shell")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PICTURES = ROOT / "tests/artefacts/python/pictures"


class Server:
    """A program that serves, and what it answers."""

    def __init__(self, address):
        self.address = address

    def send(self, method, path, body=None, kind="application/json", **headers):
        """Status, headers and body."""
        if body is not None and not isinstance(body, bytes):
            body = json.dumps(body).encode()
        request = urllib.request.Request(
            self.address + path, body, {"Content-Type": kind, **headers}, method=method
        )
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return answer.status, dict(answer.headers), answer.read()
        except urllib.error.HTTPError as answer:
            return answer.code, dict(answer.headers), answer.read()

    def upload(self, path, **parts):
        """A multipart body of files and objects."""
        boundary = uuid.uuid4().hex
        body = b""
        for name, part in parts.items():
            content = part if isinstance(part, bytes) else json.dumps(part).encode()
            head = f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"; filename="f"'
            body += head.encode() + b"\r\n\r\n" + content + b"\r\n"
        body += f"--{boundary}--\r\n".encode()
        return self.send("POST", path, body, f"multipart/form-data; boundary={boundary}")


class Program:
    """A program that serves on an address, which it keeps when it starts again."""

    def __init__(self, log):
        self.log = log
        self.listen = "127.0.0.1:0"
        self.start()

    def start(self):
        with self.log.open("wb") as out:
            self.process = subprocess.Popen(
                [os.environ["MLSWARP_PROGRAM"], "serve", "--listen", self.listen],
                stdout=out,
                stderr=subprocess.STDOUT,
            )
        while not (found := re.search(r"http://(127\.0\.0\.1:\d+)", self.log.read_text())):
            assert self.process.poll() is None, self.log.read_text()
            time.sleep(0.02)
        self.address, self.listen = found[0], found[1]

    def stop(self):
        self.process.terminate()
        self.process.wait()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    program = Program(tmp_path_factory.mktemp("server") / "log")
    yield Server(program.address)
    program.stop()


@pytest.fixture
def program(tmp_path):
    program = Program(tmp_path / "log")
    yield program
    program.stop()


class Link:
    """The relay of tests/link in front of a server: MBIT Mbit/s, MS ms each way."""

    def __init__(self, address, mbit, ms):
        link = Path(os.environ["MLSWARP_PROGRAM"]).parent / "examples/link"
        command = [link, address.removeprefix("http://"), str(mbit), str(ms)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        self.address = f"http://127.0.0.1:{self.process.stdout.readline().strip()}"

    def cut(self):
        """Ends the connections that there are."""
        self.process.stdin.write("cut\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "ok\n"


@pytest.fixture
def link(server):
    link = Link(server.address, mbit=20, ms=30)
    yield link
    link.process.stdin.close()
    link.process.wait()


@pytest.fixture(scope="session")
def cat():
    return (ROOT / "tests/images/chelsea.png").read_bytes()


P = [[168, 112], [316, 136], [262, 240], [[0, 300], [451, 300]]]
Q = [[150, 104], [338, 126], [262, 262], [[0, 300], [451, 300]]]
CAT_SIZE = (451, 300)
