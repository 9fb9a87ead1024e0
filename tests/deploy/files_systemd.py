"""Checks the systemd unit: validity, exposure level, and the program under its system call
filter."""

import ctypes
import errno
import re
import subprocess
import tempfile
from pathlib import Path

import pyseccomp

import files_program as program

UNIT = "deploy/systemd/mlswarp.service"
# Exposure level by systemd, 0 to 10 (in tenths on the command line); below 2.0 is OK.
EXPOSURE = 1.5
PROT_WRITE, PROT_EXEC = 2, 4
FAMILIES = {"AF_UNIX": 1, "AF_INET": 2, "AF_INET6": 10, "AF_NETLINK": 16}


def settings(text):
    """(name, value) of every line of the section [Service]."""
    section = text.split("[Service]")[1].split("\n[")[0]
    return [tuple(line.split("=", 1)) for line in section.splitlines() if re.match(r"\w+=", line)]


def the_last(text):
    return dict(settings(text))


def analyze(*arguments):
    return subprocess.run(
        ["systemd-analyze", "--no-pager", *arguments], capture_output=True, text=True
    )


def verified(text):
    """The output of `systemd-analyze verify` for the unit with the built program."""
    with tempfile.TemporaryDirectory() as folder:
        unit = Path(folder, "mlswarp.service")
        unit.write_text(
            text.replace("/usr/local/bin/mlswarp", str(Path(program.PROGRAM).resolve()))
        )
        done = analyze("verify", "--man=no", str(unit))
        said = [line for line in done.stderr.splitlines() if "mlswarp.service" in line]
        return said or ([done.stderr] if done.returncode else [])


def exposure(path):
    done = analyze("security", "--offline=true", "--threshold=100", path)
    return float(re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)[1])


def calls(words):
    """The system calls of a SystemCallFilter= line."""
    found = set()
    for word in words.split():
        if word.startswith("@"):
            lines = analyze("syscall-filter", word).stdout.splitlines()
            found |= calls(
                " ".join(
                    line.strip()
                    for line in lines[1:]
                    if line.strip() and not line.strip().startswith("#")
                )
            )
        else:
            found.add(word)
    return found


def allowed(text):
    """Evaluates the lines like systemd: the first starts a list of allowed calls, a line with ~
    removes calls, others add them."""
    may = set()
    for name, value in settings(text):
        if name == "SystemCallFilter":
            may = may - calls(value[1:]) if value.startswith("~") else may | calls(value)
    return may


def filter_of(text):
    """The unit's filter as a function that takes it upon the process. What it does not allow ends
    the program, where systemd would answer EPERM: so a call that the program survives without is
    seen as well."""
    may = sorted(allowed(text))
    last = the_last(text)
    families = {FAMILIES[word] for word in last["RestrictAddressFamilies"].split()}

    def take():
        taken = pyseccomp.SyscallFilter(pyseccomp.KILL_PROCESS)
        # The process with the filter starts the program.
        for call in [*may, "execve"]:
            try:
                if call in ("socket", "mprotect", "mmap"):
                    continue
                taken.add_rule(pyseccomp.ALLOW, call)
            except (OSError, ValueError):
                # System calls of other architectures.
                pass
        for family in families:
            taken.add_rule(pyseccomp.ALLOW, "socket", pyseccomp.Arg(0, pyseccomp.EQ, family))
        if last["MemoryDenyWriteExecute"] == "yes":
            taken.add_rule(
                pyseccomp.ALLOW, "mprotect", pyseccomp.Arg(2, pyseccomp.MASKED_EQ, PROT_EXEC, 0)
            )
            for protection in (0, PROT_WRITE, PROT_EXEC):
                taken.add_rule(
                    pyseccomp.ALLOW,
                    "mmap",
                    pyseccomp.Arg(2, pyseccomp.MASKED_EQ, PROT_WRITE | PROT_EXEC, protection),
                )
        if ctypes.CDLL(None, use_errno=True).prctl(38, 1, 0, 0, 0):  # PR_SET_NO_NEW_PRIVS
            raise OSError(errno.EPERM, "no_new_privs")
        taken.load()

    return take


def environment(text):
    return dict(value.split("=", 1) for name, value in settings(text) if name == "Environment")


def work(ask):
    """Typical requests: an upload as a session, a drag, a mesh, metrics, health."""
    picture = Path("tests/images/chelsea.png").read_bytes()
    border = b"--x\r\nContent-Disposition: form-data; name="
    form = (
        border
        + b'"image"; filename="cat.png"\r\nContent-Type: image/png\r\n\r\n'
        + picture
        + b"\r\n"
    )
    form += border + b'"warp"\r\n\r\n{"p": [[168, 112], [316, 136]]}\r\n--x--\r\n'
    status, body = ask(
        "MLSWARP_LISTEN", "/sessions", form, {"Content-Type": "multipart/form-data; boundary=x"}
    )
    assert status == 201, (status, body[:300])
    session = re.search(rb'"id":\s*"([^"]+)"', body)[1].decode()
    pose = b'{"q": [[150, 104], [338, 126]], "output": {"format": "%s"}}'
    for kind in (b"png", b"jpeg", b"webp"):
        status, body = ask(
            "MLSWARP_LISTEN",
            f"/sessions/{session}/warp",
            pose % kind,
            {"Content-Type": "application/json"},
        )
        assert status == 200 and len(body) > 10_000, (kind, status, body[:300])
    assert (
        ask(
            "MLSWARP_LISTEN",
            f"/sessions/{session}/mesh",
            b'{"q": [[150, 104], [338, 126]]}',
            {"Content-Type": "application/json"},
        )[0]
        == 200
    )
    for path in ("/metrics", "/healthz", "/readyz"):
        assert ask("MLSWARP_LISTEN", path)[0] == 200, path


def check():
    """Runs all checks; yields (name, messages)."""
    text = Path(UNIT).read_text()
    yield "systemd takes the unit", verified(text)
    wrong = verified(text.replace("ProtectHome=yes", "ProtectHome=yes\nProtectHouse=yes"))
    yield (
        "an unknown setting is seen",
        []
        if any("ProtectHouse" in line for line in wrong)
        else [f"ProtectHouse is taken: {wrong}"],
    )

    found = exposure(UNIT)
    yield (
        f"exposure {found} of 10, at most {EXPOSURE}",
        [] if found <= EXPOSURE else [f"exposure {found}"],
    )

    declared, own = program.declared(), environment(text)
    said = [f"the program has no variable {name}" for name in own if name not in declared]
    last = the_last(text)
    needed = program.seconds(declared["MLSWARP_DRAIN_DELAY"]) + program.seconds(
        declared["MLSWARP_SHUTDOWN_GRACE"]
    )
    if not needed + 3 <= float(last["TimeoutStopSec"]):
        said.append(f"it takes {needed} s to stop; {last['TimeoutStopSec']} are given")
    if not own.get("MLSWARP_STORE", "").startswith(f"file:%S/{last['StateDirectory']}/"):
        said.append("no state directory for MLSWARP_STORE")
    yield "variables, grace and places are the program's", said

    with program.serving(own, preexec=filter_of(text)) as ask:
        work(ask)
    yield "the program serves, and stops, under the unit's filter", []
    try:
        narrow = text.replace("SystemCallFilter=setpriority prlimit64\n", "").replace(
            "~@privileged @resources", "~@privileged @resources @network-io"
        )
        with program.serving(own, preexec=filter_of(narrow)) as ask:
            work(ask)
        seen = ["a filter without the network is not noticed"]
    except AssertionError:
        seen = []
    yield "a filter that is too narrow is seen", seen
