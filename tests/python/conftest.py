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


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    log = tmp_path_factory.mktemp("server") / "log"
    with log.open("wb") as out:
        program = subprocess.Popen(
            [os.environ["MLSWARP_PROGRAM"], "serve", "--listen", "127.0.0.1:0"],
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    try:
        while not (found := re.search(r"http://127\.0\.0\.1:\d+", log.read_text())):
            assert program.poll() is None, log.read_text()
            time.sleep(0.02)
        yield Server(found[0])
    finally:
        program.terminate()
        program.wait()


@pytest.fixture(scope="session")
def cat():
    return (ROOT / "tests/images/chelsea.png").read_bytes()


P = [[168, 112], [316, 136], [262, 240], [[0, 300], [451, 300]]]
Q = [[150, 104], [338, 126], [262, 262], [[0, 300], [451, 300]]]
CAT_SIZE = (451, 300)
