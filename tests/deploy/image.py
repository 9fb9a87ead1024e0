"""One container of the image: size, isolation, health, settings."""

import http.client
import json
import os
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from commands import Failure, free_port, say, text, where
from images import IMAGE
from pictures import decode_png, moved_share, photograph

# A slower stop would be killed: `docker stop` waits ten seconds.
STOP_SECONDS = 9.0
READY_SECONDS = 20.0
HEALTHY_SECONDS = 30.0
# Far above the size of the program, far below any base image with a distribution.
IMAGE_BYTES = 40_000_000
# The share of pixels that a warp must have moved.
MOVED_SHARE = 0.01


class Container:
    """A container of the image on the loopback of the host, isolated like in a cluster; removed at
    the end."""

    def __init__(self, engine, *options, **environment):
        self.engine, self.port = engine, free_port()
        self.name = f"mlswarp-test-{os.getpid()}-{self.port}"
        environment["MLSWARP_LISTEN"] = f"127.0.0.1:{self.port}"
        engine(
            "run", "--detach", "--name", self.name, "--network=host", "--read-only",
            "--cap-drop=ALL",
            "--security-opt=no-new-privileges", "--health-interval=1s", *options,
            *(part for k, v in environment.items() for part in ("--env", f"{k}={v}")), IMAGE,
        )  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        if kind is not None:
            done = self.engine("logs", "--tail", "40", self.name, check=False)
            say("the container said:\n" + (done.stdout + done.stderr).decode(errors="replace"))
        self.engine("rm", "--force", self.name, check=False)

    def state(self):
        return json.loads(self.engine.text("inspect", "--format", "{{json .State}}", self.name))

    def get(self, path, **headers):
        try:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=2)
            connection.request("GET", path, headers=headers)
            return connection.getresponse().status
        except OSError:
            return None
        finally:
            connection.close()

    def wait_ready(self):
        """Seconds from the start of the program to the first 200 of /readyz."""
        deadline = time.monotonic() + READY_SECONDS
        while self.get("/readyz") != 200:
            if time.monotonic() > deadline:
                raise Failure(f"not ready after {READY_SECONDS:.0f} s: {self.state()}")
            time.sleep(0.005)
        ready = datetime.now(UTC)
        started = self.state()["StartedAt"][:26].rstrip("Z")
        return (ready - datetime.fromisoformat(started).replace(tzinfo=UTC)).total_seconds()

    def warp(self, photograph, spec):
        """(status, content type, body) of a warp requested with curl."""
        with tempfile.TemporaryDirectory(prefix="mlswarp-answer-") as place:
            body = Path(place) / "body"
            printed = text(
                where("curl"),
                "--silent",
                "--show-error",
                "--max-time",
                "30",
                "--output",
                body,
                "--write-out",
                "%{http_code} %{content_type}",
                "--form",
                f"image=@{photograph}",
                "--form",
                f"warp={json.dumps(spec)}",
                f"http://127.0.0.1:{self.port}/warp",
            )
            status, _, kind = printed.partition(" ")
            return int(status), kind, body.read_bytes() if body.exists() else b""


def check_image(engine, check):
    facts = json.loads(engine.text("image", "inspect", IMAGE))[0]
    settings, layers = facts["Config"], len(facts["RootFS"]["Layers"])
    check(
        "the image is small",
        facts["Size"] <= IMAGE_BYTES,
        f"{facts['Size'] / 1e6:.2f} MB in {layers} layer(s)",
    )
    user = settings["User"].split(":")[0]
    check("its user is a number and not root", user.isdigit() and int(user) > 0, settings["User"])
    check(
        "it listens for others by default",
        "MLSWARP_LISTEN=0.0.0.0:8080" in settings["Env"],
        settings["Env"][-1],
    )
    shell = engine(
        "run", "--rm", "--network=none", "--entrypoint", "/bin/sh", IMAGE, "-c", "true", check=False
    )
    check("there is no shell in it", shell.returncode == 127, f"exit {shell.returncode}")
    nobody = engine(
        "run",
        "--rm",
        "--network=host",
        "--env",
        f"MLSWARP_LISTEN=127.0.0.1:{free_port()}",
        IMAGE,
        "health",
        check=False,
    )
    check(
        "`health` says no where nobody listens", nobody.returncode == 1, f"exit {nobody.returncode}"
    )
    # Without keys it refuses to start, and prints the alternatives.
    refused = engine("run", "--rm", "--network=none", IMAGE, check=False)
    said = refused.stderr.decode(errors="replace")
    check("without a key it does not start", refused.returncode == 2, f"exit {refused.returncode}")
    check(
        "and says what to do",
        "MLSWARP_KEYS" in said and "MLSWARP_ALLOW_ANONYMOUS=true" in said,
        said.splitlines()[0] if said else "",
    )
    anonymous = f"mlswarp-test-{os.getpid()}-anonymous"
    engine(
        "run",
        "--detach",
        "--name",
        anonymous,
        "--network=none",
        "--env",
        "MLSWARP_ALLOW_ANONYMOUS=true",
        "--health-interval=1s",
        IMAGE,
    )
    try:
        deadline = time.monotonic() + HEALTHY_SECONDS
        while (
            health := engine.text("inspect", "--format", "{{.State.Health.Status}}", anonymous)
        ) == "starting" and time.monotonic() < deadline:
            time.sleep(0.1)
        check("it starts where everybody may come in", health == "healthy", health)
    finally:
        engine("rm", "--force", anonymous, check=False)


def check_service(engine, check):
    picture, width, height, pixels = photograph()
    with Container(engine) as service:
        say(f"ready {service.wait_ready() * 1000:.0f} ms after its start")
        deadline = time.monotonic() + HEALTHY_SECONDS
        while (
            health := service.state()["Health"]["Status"]
        ) == "starting" and time.monotonic() < deadline:
            time.sleep(0.1)
        check("its HEALTHCHECK finds it healthy", health == "healthy", health)

        lines = Path(f"/proc/{service.state()['Pid']}/status").read_text().splitlines()
        status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
        check(
            "no identity of the process is root",
            "0" not in status["Uid"].split() + status["Gid"].split(),
            status["Uid"].split(),
        )
        check(
            "it holds no capability",
            int(status["CapEff"], 16) == int(status["CapPrm"], 16) == 0,
            status["CapEff"],
        )

        rest = [[0, 0], [width, 0], [0, height], [width, height], [width / 2, height / 2]]
        code, kind, body = service.warp(picture, {"p": rest, "q": rest})
        check("an identity answers a PNG", (code, kind) == (200, "image/png"), f"{code} {kind}")
        check(
            "and every pixel comes back",
            code == 200 and decode_png(body) == (width, height, pixels),
        )
        posed = [*rest[:4], [width * 0.62, height * 0.4]]
        code, kind, body = service.warp(picture, {"p": rest, "q": posed})
        check(
            "a warp answers a PNG",
            (code, kind) == (200, "image/png"),
            f"{code} {kind} {len(body)} bytes",
        )
        warped = decode_png(body)
        check("of the source's size", warped[:2] == (width, height), f"{warped[0]} x {warped[1]}")
        share = moved_share(warped[2], pixels) if warped[:2] == (width, height) else 0.0
        check("which differs from the source", share > MOVED_SHARE, f"{share:.1%} of the pixels")

        begun = time.monotonic()
        engine("stop", service.name)
        took, state = time.monotonic() - begun, service.state()
        check(
            "a stop is obeyed in time",
            took < STOP_SECONDS and not state["OOMKilled"],
            f"{took:.2f} s",
        )
        check("and ends with 0", state["ExitCode"] == 0, f"exit {state['ExitCode']}")

    limit = picture.stat().st_size // 2
    with Container(engine, MLSWARP_MAX_BODY_BYTES=limit) as service:
        service.wait_ready()
        code, kind, body = service.warp(picture, {"p": [[0, 0]], "q": [[0, 0]]})
        check(
            "a limit of the environment is obeyed",
            code == 413,
            f"{code} for {picture.stat().st_size} bytes at a limit of {limit}",
        )
        problem = json.loads(body) if kind.startswith("application/problem+json") else {}
        said = (problem.get("status"), problem.get("code"))
        check("by a problem document", said == (413, "too_large"), f"{kind} {said}")

    volume = f"mlswarp-test-{os.getpid()}"
    try:
        with Container(
            engine, "--volume", f"{volume}:/data", MLSWARP_STORE="file:/data/sessions.db"
        ) as service:
            service.wait_ready()
            code = service.get("/readyz")
        check("sessions can live in a volume", code == 200, code)
    finally:
        engine("volume", "rm", "--force", volume, check=False)

    with Container(engine, MLSWARP_KEYS="ann a-key-of-the-test-0123456789") as service:
        service.wait_ready()
        unknown = "/sessions/8f3b1c1e-6f0a-4c8e-9d53-0f1a2b3c4d5e"
        codes = [
            service.get(unknown),
            service.get(unknown, Authorization="Bearer another-key-0123456789"),
        ]
        codes.append(service.get(unknown, Authorization="Bearer a-key-of-the-test-0123456789"))
        check("a key of the environment is wanted", codes == [401, 403, 404], codes)
