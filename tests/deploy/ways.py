"""The first block for Docker, Docker Compose and systemd in deploy/README.md, run as it is written
there. Docker and Compose use an engine with the bridges and ports that Docker makes, in a network
of its own; systemd boots in a container. Different is only:

- `docker build` uses the base image of this test and the network of the host, because nothing can
  be pulled;
- `docker compose` is Debian's `docker-compose`; the images of HAProxy, Valkey and Prometheus
  contain Debian's programs, and Grafana sleeps;
- `cargo build` takes the program from the image: Debian has no Rust of this version.

The block for Kubernetes is checked by `files`, without a cluster.
"""

import contextlib
import json
import os
import re
import shutil
import stat
import time
from pathlib import Path

from commands import ROOT, Failure, run, say, text, timed, where
from engine import Apart
from images import IMAGE, build_options, copied, systemd_image
from readme_commands import block

COMPOSE = ROOT / "deploy" / "compose.yaml"
# The program that an image of compose.yaml starts by itself; where it is not named, the services'
# image starts it.
ENTRY = {"prometheus": '["/bin/prometheus"]', "grafana": '["/bin/sleep", "1000"]'}
BOOT_SECONDS = 60.0
# The name of the built image in the engine that builds, which may be one that others use.
TAG = "mlswarp-test/ways"
KEY = re.compile(r"ann (\S{16,})")


def docker_of(stage, engine, place):
    """A directory with the `docker` that the commands call."""
    place.mkdir()
    # BuildKit finds every layer in its cache: the image was built with the same options and from a
    # copy of the same files, with the same modes.
    options = " ".join(map(str, build_options(stage.engine)))
    own = (
        *stage.engine.prefix,
        "env",
        f"DOCKER_BUILDKIT={int(stage.engine.buildkit)}",
        stage.engine.client,
        *stage.engine.host,
    )
    own = " ".join(map(str, own))
    other = " ".join(map(str, (*engine.prefix, engine.client, *engine.host)))
    compose = (*engine.prefix, "env", f"DOCKER_HOST={engine.host[1]}", where("docker-compose"))
    compose = " ".join(map(str, compose))
    script = place / "docker"
    script.write_text(f"""#!/bin/sh
set -e
case $1 in
    build)
        shift
        for word; do
            shift
            [ "$word" = mlswarp ] && word={TAG}
            set -- "$@" "$word"
        done
        {own} build {options} "$@"
        {own} save {TAG} | {other} load
        {other} tag {TAG} mlswarp ;;
    compose) shift; exec {compose} --ansi never "$@" ;;
    *) exec {other} "$@" ;;
esac
""")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    return place


def as_written(check, section, command):
    """Runs the block of a section, which ends at its first failure; returns whether it
    succeeded."""
    with timed(f"the commands of {section}"):
        done = run(*command, "bash", "-euo", "pipefail", "-c", block(section), check=False)
    printed = (done.stdout + done.stderr).decode(errors="replace").strip()
    found = f"exit {done.returncode}\n{printed[-3000:]}" if done.returncode else ""
    check(f"{section}: the commands succeed as they are written", done.returncode == 0, found)
    return done.returncode == 0


def is_png(file):
    return file.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def check_docker(stage, engine, folder, inside):
    try:
        if as_written(stage.check, "Docker", inside):
            stage.check("Docker: the picture is there", is_png(folder / "warped.png"))
            layers = [
                stage.engine.text("inspect", "--format", "{{json .RootFS.Layers}}", name)
                for name in (IMAGE, TAG)
            ]
            stage.check("Docker: nothing was compiled a second time", layers[0] == layers[1])
            state = json.loads(
                engine.text("inspect", "--format", "{{json .HostConfig}}", "mlswarp")
            )
            hardened = (
                state["ReadonlyRootfs"] and state["CapDrop"] == ["ALL"] and state["Memory"] > 0
            )
            stage.check(
                "Docker: the container is read-only, without capabilities, with limited memory",
                hardened,
            )
            refused = run(
                *inside,
                "curl",
                "-sS",
                "-o",
                "/dev/null",
                "-w",
                "%{http_code}",
                "http://127.0.0.1:8080/metrics",
            ).stdout.decode()
            stage.check("Docker: without the key it is closed", refused == "401", refused)
    finally:
        engine("rm", "--force", "mlswarp", check=False)


def check_compose(stage, engine, folder, inside):
    (folder / "warped.png").unlink(missing_ok=True)
    for name, image in re.findall(
        r"^  (\w+):\n    <<: \*locked\n    image: (\S+)$", COMPOSE.read_text(), re.M
    ):
        lines = [f"ENTRYPOINT {ENTRY[name]}", "CMD []"] if name in ENTRY else []
        engine.load(stage.engine, stage.services, image, *lines)
    compose = ("docker", "compose", "-f", "deploy/compose.yaml")
    try:
        if as_written(stage.check, "Docker Compose", inside):
            stage.check("Docker Compose: the picture is there", is_png(folder / "warped.png"))
            replicas = run(*inside, *compose, "ps", "--quiet", "mlswarp").stdout.split()
            stage.check(
                "Docker Compose: a third replica has joined",
                len(replicas) == 3,
                f"{len(replicas)} replicas",
            )
    finally:
        if stage.check.failed:
            done = run(*inside, *compose, "logs", "--no-color", "--tail", "15", check=False)
            say("the stack said:\n" + (done.stdout + done.stderr).decode(errors="replace")[-8000:])
        run(*inside, *compose, "down", "--volumes", "--timeout", "5", check=False)


# In the order of their numbers (linux/capability.h).
CAPABILITIES = (
    "CHOWN DAC_OVERRIDE DAC_READ_SEARCH FOWNER FSETID KILL SETGID SETUID SETPCAP LINUX_IMMUTABLE "
    "NET_BIND_SERVICE NET_BROADCAST "
    "NET_ADMIN NET_RAW IPC_LOCK IPC_OWNER SYS_MODULE SYS_RAWIO SYS_CHROOT SYS_PTRACE SYS_PACCT "
    "SYS_ADMIN SYS_BOOT SYS_NICE SYS_RESOURCE "
    "SYS_TIME SYS_TTY_CONFIG MKNOD LEASE AUDIT_WRITE AUDIT_CONTROL SETFCAP MAC_OVERRIDE MAC_ADMIN "
    "SYSLOG WAKE_ALARM BLOCK_SUSPEND AUDIT_READ"
).split()


def capabilities():
    """The capabilities that a process of this machine can have."""
    bounding = int(
        re.search(r"^CapBnd:\s+(\w+)", Path("/proc/self/status").read_text(), re.M)[1], 16
    )
    return [name for number, name in enumerate(CAPABILITIES) if bounding >> number & 1]


@contextlib.contextmanager
def booted(stage, engine, folder):
    """A container in which systemd is the first process, with the files at /src and a `cargo` that
    takes the program from the image."""
    name = f"mlswarp-test-{os.getpid()}-systemd"
    engine.load(stage.engine, systemd_image(stage.engine), "mlswarp-test/systemd-here")
    given = folder.parent / "given"
    given.mkdir()
    shutil.copy2(stage.program, given / "mlswarp")
    cargo = given / "cargo"
    cargo.write_text("#!/bin/sh\nexec install -D -m 0755 /given/mlswarp target/release/mlswarp\n")
    cargo.chmod(0o755)
    # What `--privileged` gives, but only those capabilities that this machine has.
    rights = [f"--cap-add={capability}" for capability in capabilities()]
    rights += [
        f"--security-opt={what}=unconfined" for what in ("seccomp", "apparmor", "systempaths")
    ]
    if Path("/sys/fs/cgroup/cgroup.controllers").exists():
        groups, writable = ["--cgroupns=private"], "mount -o remount,rw /sys/fs/cgroup && "
    else:
        groups, writable = ["--volume", "/sys/fs/cgroup:/sys/fs/cgroup"], ""
    # systemd passes credentials to a service by a mount that must propagate to it.
    boot = f"{writable}mount --make-rshared / && exec /lib/systemd/systemd"
    engine(
        "run", "--detach", "--name", name, *rights, *groups, "--tmpfs", "/run", "--tmpfs",
        "/run/lock", "--volume", f"{folder}:/src",
        "--volume", f"{given}:/given:ro", "--workdir", "/src", "--env", "container=docker",
        "mlswarp-test/systemd-here", "sh", "-c", boot,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + BOOT_SECONDS
        while (
            state := engine.text("exec", name, "systemctl", "is-system-running", check=False)
        ) not in ("running", "degraded"):
            if time.monotonic() > deadline:
                raise Failure(
                    f"systemd did not boot in the container: {state!r}: "
                    f"{engine.text('logs', '--tail', '20', name, check=False)}"
                )
            time.sleep(0.2)
        yield [
            *engine.prefix,
            engine.client,
            *engine.host,
            "exec",
            "--env",
            "PATH=/given:/usr/sbin:/usr/bin:/sbin:/bin",
            name,
        ]
    finally:
        engine("rm", "--force", name, check=False)


def check_systemd(stage, engine, folder):
    with booted(stage, engine, folder) as inside:
        if not as_written(stage.check, "systemd", inside):
            say(
                "the unit said:\n"
                + text(
                    *inside, "journalctl", "--no-pager", "-n", "30", "-u", "mlswarp", check=False
                )
            )
            say(text(*inside, "systemctl", "status", "--no-pager", "mlswarp", check=False))
            return
        shown = text(*inside, "systemctl", "show", "mlswarp", "-p", "ActiveState,MainPID,NRestarts")
        shown = dict(line.split("=", 1) for line in shown.splitlines())
        stage.check(
            "systemd: the unit is active",
            shown["ActiveState"] == "active" and shown["NRestarts"] == "0",
            shown,
        )
        status = text(*inside, "cat", f"/proc/{shown['MainPID']}/status")
        found = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
        unprivileged = "0" not in found["Uid"].split() and int(found["CapEff"], 16) == 0
        stage.check(
            "systemd: the program is not root and has no capability",
            unprivileged,
            found["Uid"].split(),
        )
        filtered = (found["NoNewPrivs"], found["Seccomp"]) == ("1", "2")
        stage.check(
            "systemd: it cannot gain privileges, and its system calls are filtered", filtered
        )
        key = KEY.search(text(*inside, "cat", "/etc/mlswarp/keys"))[1]
        ask = (
            "curl",
            "-sS",
            "--fail-with-body",
            "--retry",
            "20",
            "--retry-all-errors",
            "--retry-delay",
            "1",
            "-H",
            f"Authorization: Bearer {key}",
        )
        opened = text(
            *inside,
            *ask,
            "-F",
            "image=@tests/images/chelsea.png",
            "-F",
            'warp={"p":[[9,9]]}',
            "http://127.0.0.1:8080/sessions",
        )
        run(*inside, "systemctl", "restart", "mlswarp")
        kept = run(
            *inside, *ask, f"http://127.0.0.1:8080/sessions/{json.loads(opened)['id']}", check=False
        )
        stage.check(
            "systemd: a session survives a restart",
            kept.returncode == 0,
            kept.stdout.decode()[:200] if kept.returncode else "",
        )
        run(*inside, "systemctl", "stop", "mlswarp")
        result = text(*inside, "systemctl", "show", "mlswarp", "-p", "Result", "--value")
        stage.check("systemd: it stops without a failure", result == "success", result)


def check_ways(stage):
    folder = copied(stage.scratch / "ways" / "src")
    engine = Apart()
    try:
        engine.open()
        path = f"{docker_of(stage, engine, stage.scratch / 'ways' / 'bin')}:{os.environ['PATH']}"
        # Where the published ports are, with nothing of this machine's settings.
        inside = (
            *engine.inside,
            "env",
            "--ignore-environment",
            "--chdir",
            folder,
            f"PATH={path}",
            f"HOME={folder}",
        )
        check_docker(stage, engine, folder, inside)
        check_compose(stage, engine, folder, inside)
        check_systemd(stage, engine, folder)
    finally:
        engine.stop()
