"""Commands, their output, and counted checks."""

import contextlib
import os
import shutil
import socket
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
CACHE = Path(os.environ.get("MLSWARP_TEST_CACHE") or Path.home() / ".cache" / "mlswarp-tests")
AS_ROOT = [] if os.geteuid() == 0 else ["sudo", "-n"]


class Failure(Exception):
    """The test cannot continue; the text has the reason."""


def run(*command, check=True, env=None, stdin=None):
    """Runs a command and returns it with its output."""
    done = subprocess.run(
        [str(c) for c in command],
        stdin=stdin or subprocess.DEVNULL,
        capture_output=True,
        env=env,
    )
    if check and done.returncode != 0:
        printed = (done.stdout + done.stderr).decode(errors="replace").strip()
        raise Failure(
            f"`{' '.join(map(str, command))}` exited with {done.returncode}:\n{printed[-6000:]}"
        )
    return done


def text(*command, **options):
    return run(*command, **options).stdout.decode(errors="replace").strip()


def say(line):
    print(f"deploy: {line}", flush=True)


@contextlib.contextmanager
def timed(what):
    say(f"{what} ...")
    begun = time.monotonic()
    yield
    say(f"{what}: {time.monotonic() - begun:.1f} s")


def install(*packages):
    """Installs Debian packages if one of their programs is missing."""
    if shutil.which("apt-get") is None:
        raise Failure(f"missing: {', '.join(packages)} (and there is no apt-get to install them)")
    quiet = [*AS_ROOT, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-q"]
    with timed(f"installing {', '.join(packages)}"):
        run(*quiet, "update")
        run(*quiet, "install", "--yes", "--no-install-recommends", *packages)


def where(program):
    """The path of a program, including directories for root."""
    return shutil.which(program, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin:/usr/bin:/bin")


class Checks:
    """Counts passed checks and records failed ones."""

    def __init__(self):
        self.held, self.failed = 0, []

    def __call__(self, name, truth, found=""):
        if truth:
            self.held += 1
        else:
            self.failed.append(name)
        say(f"{'ok  ' if truth else 'FAIL'} {name}{f': {found}' if found != '' else ''}")


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]
