"""nginx and HAProxy with the files of `deploy`, one replica, and the lines of deploy/README.md for
a path prefix."""

import http.client
import os
import re
import shutil
import socket
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

from support import DEADLINE, KEPT, Server

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
PREFIX = "/tools/warp"


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def documented(language):
    """The block of the section "Behind a path prefix" in a language."""
    section = (
        (DEPLOY / "README.md").read_text().split("\n## Behind a path prefix\n")[1].split("\n## ")[0]
    )
    return re.search(rf"```{language}\n(.*?)```", section, re.DOTALL)[1]


def replaced(text, *changes):
    """Replaces parts of a text, each of which must occur the stated number of times."""
    for old, new, times in changes:
        assert text.count(old) == times, f"`{old}` is there {text.count(old)} times, not {times}"
        text = text.replace(old, new)
    return text


def nginx(port, replica, folder):
    """Writes the configuration; returns the command and its environment."""
    text = replaced(
        (DEPLOY / "nginx" / "nginx.conf").read_text(),
        ("listen 127.0.0.1:8080;", f"listen 127.0.0.1:{port};", 1),
        ("server 127.0.0.1:8081 ", f"server 127.0.0.1:{replica} ", 2),
        ("        server 127.0.0.1:8082 max_fails=1 fail_timeout=2s;\n", "", 2),
        ("pid /tmp/nginx.pid;", f"pid {folder}/nginx.pid;", 1),
        (
            "http {\n",
            "http {\n"
            + "".join(
                f"{kind}_temp_path {folder}/{kind};\n"
                for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
            ),
            1,
        ),
        ("server_name _;\n", f"server_name _;\n{documented('nginx')}", 1),
        ('"type":"/problems/', f'"type":"{PREFIX}/problems/', 5),
    )
    (folder / "nginx.conf").write_text(text)
    return ["nginx", "-e", "stderr", "-c", folder / "nginx.conf", "-g", "daemon off;"], {}


def haproxy(port, replica, folder):
    text = (DEPLOY / "haproxy" / "haproxy.cfg").read_text()
    text = replaced(
        text,
        (
            '    bind "${PROXY_LISTEN}"\n',
            f'    bind "${{PROXY_LISTEN}}"\n{documented("haproxy")}',
            1,
        ),
        ('"type":"/problems/', f'"type":"{PREFIX}/problems/', 6),
    )
    (folder / "haproxy.cfg").write_text(text)
    settings = {
        "PROXY_LISTEN": f"127.0.0.1:{port}",
        "PROXY_METRICS_LISTEN": f"127.0.0.1:{free_port()}",
        "PROXY_REPLICAS": f"127.0.0.1:{replica}",
        "PROXY_DNS": f"127.0.0.1:{free_port()}",
    }
    return ["haproxy", "-db", "-f", folder / "haproxy.cfg"], settings


PROXIES = {"nginx": nginx, "haproxy": haproxy}


class Published(Server):
    """The server as clients of a proxy reach it: its address contains the prefix."""

    def __init__(self, port):
        self.port = port
        self.address = f"http://127.0.0.1:{port}{PREFIX}"

    def ask(self, method, path, value=None):
        return super().ask(method, PREFIX + path, value)


@contextmanager
def published(name, folder):
    """A server behind a proxy."""
    server = Server("--public-path", PREFIX, "--trusted-proxies", "127.0.0.1")
    proxied = Published(free_port())
    (command, *options), settings = PROXIES[name](proxied.port, server.port, folder)
    # Debian installs both in directories that are not in the PATH of every user.
    path = shutil.which(command, path=f"{os.environ['PATH']}:/usr/sbin:/usr/local/sbin")
    assert path, f"{command} is not in PATH: tests/run installs its Debian package"
    with open(KEPT / f"{name}.log", "wb") as log:
        process = subprocess.Popen(
            [path, *options],
            env={**os.environ, **settings},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
    try:
        give_up = time.monotonic() + DEADLINE
        while not is_ready(proxied):
            assert process.poll() is None and time.monotonic() < give_up, (
                f"{name} does not start: {log.name}"
            )
            time.sleep(0.05)
        yield proxied
    finally:
        proxied.leave()
        process.terminate()
        process.wait(DEADLINE)
        server.stop()


def is_ready(proxied):
    try:
        return proxied.ask("GET", "/readyz").status == 200
    except (OSError, http.client.HTTPException):
        return False
