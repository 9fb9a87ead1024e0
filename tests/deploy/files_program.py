"""Runs the program with the variables of the files in deploy/, on loopback ports and with temporary
keys."""

import contextlib
import os
import re
import signal
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

PROGRAM = os.environ["MLSWARP_PROGRAM"]
WAIT_SECONDS = 20.0


def declared():
    """Every variable in `mlswarp serve --help`, with its default."""
    said = subprocess.run(
        [PROGRAM, "serve", "--help"], check=True, capture_output=True, text=True, env=clean()
    ).stdout
    variables = {}
    for option in re.split(r"\n(?= {2,}(?:-\w, )?--)", said):
        if name := re.search(r"\[env:\s+(MLSWARP_\w+)", option):
            default = re.search(r"\[default:\s+([^\]]*)\]", option)
            variables[name[1]] = default[1] if default else ""
    return variables


def clean(variables=None):
    """The environment of this process with only these variables of the program."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("MLSWARP_")}
    return {**kept, "RUST_BACKTRACE": "0", **(variables or {})}


def seconds(text):
    """`500ms`, `20s`, `1m`, `1h`, and several of them, as seconds."""
    units = {"ms": 0.001, "s": 1, "m": 60, "h": 3600}
    parts = re.findall(r"([\d.]+)(ms|s|m|h)", text)
    if not parts or "".join(number + unit for number, unit in parts) != text:
        raise ValueError(f"`{text}` is no span of time")
    return sum(float(number) * units[unit] for number, unit in parts)


def free_port():
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@contextlib.contextmanager
def serving(variables, preexec=None):
    """A server with these variables: its addresses are moved to the loopback, its keys file and its
    store to where this test can have them. Yields a function that asks, `ask(variable of the
    listener, path) -> (status, body)`; the program must end with 0 afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        here = dict(variables)
        ports = {}
        for name in ("MLSWARP_LISTEN", "MLSWARP_METRICS_LISTEN"):
            if here.get(name) or name == "MLSWARP_LISTEN":
                ports[name] = free_port()
                here[name] = f"127.0.0.1:{ports[name]}"
        if "MLSWARP_KEYS_FILE" in here:
            here["MLSWARP_KEYS_FILE"] = f"{folder}/keys"
            Path(folder, "keys").write_text("test 0123456789abcdef\n")
        store = here.get("MLSWARP_STORE", "")
        here["MLSWARP_STORE"] = (
            f"file:{folder}/sessions.db" if store.startswith("file:") else "memory"
        )
        # Not needed here.
        if "MLSWARP_DRAIN_DELAY" in here:
            here["MLSWARP_DRAIN_DELAY"] = "10ms"
        with open(f"{folder}/log", "w+") as log:
            process = subprocess.Popen(
                [PROGRAM, "serve"],
                env=clean(here),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                preexec_fn=preexec,
            )

            def ask(listener, path, data=None, headers=None):
                url = f"http://127.0.0.1:{ports[listener]}{path}"
                headers = {"Authorization": "Bearer 0123456789abcdef", **(headers or {})}
                try:
                    with urllib.request.urlopen(
                        urllib.request.Request(url, data=data, headers=headers),
                        timeout=WAIT_SECONDS,
                    ) as answer:
                        return answer.status, answer.read()
                except urllib.error.HTTPError as refused:
                    return refused.code, refused.read()

            try:
                begun = time.monotonic()
                while True:
                    with contextlib.suppress(OSError):
                        if ask("MLSWARP_LISTEN", "/readyz")[0] == 200:
                            break
                    if process.poll() is not None or time.monotonic() - begun > WAIT_SECONDS:
                        raise AssertionError(
                            f"the program does not start: {Path(log.name).read_text()[-2000:]}"
                        )
                    time.sleep(0.05)
                yield ask
                process.send_signal(signal.SIGTERM)
                status = process.wait(WAIT_SECONDS)
                assert status == 0, (
                    f"the program ended with {status}: {Path(log.name).read_text()[-2000:]}"
                )
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
