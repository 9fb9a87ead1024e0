"""The parts of the test in order, and their shared state."""

import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import chaos
import envoy
import image
import nginx
import retries
import scaling
import start
import ways
from commands import Checks
from engine import Engine
from images import IMAGE, build, program, services_image


@dataclass
class Stage:
    """The shared state of the parts."""

    engine: Engine
    check: Checks
    scratch: Path

    @cached_property
    def services(self):
        return services_image(self.engine)

    @cached_property
    def program(self):
        return program(self.engine, self.scratch / "mlswarp")


def check_image(stage):
    image.check_image(stage.engine, stage.check)
    image.check_service(stage.engine, stage.check)


def check_again(stage):
    """A build without cache gives the same bytes. It takes minutes, so it runs only in the long
    form or on request."""
    other = f"{IMAGE}-again"
    build(stage.engine, other, "--no-cache")
    try:
        files = (stage.program, program(stage.engine, stage.scratch / "again", other))
        digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
        stage.check(
            "two builds of one tree give the same program",
            digests[0] == digests[1],
            " and ".join(digests),
        )
    finally:
        stage.engine("image", "rm", "--force", other, check=False)


PARTS = {
    "image": check_image,
    "ways": ways.check_ways,
    "stack": chaos.check_stack,
    "retries": retries.check_retries,
    "nginx": nginx.check_nginx,
    "envoy": envoy.check_envoy,
    "scaling": scaling.check_scaling,
    "start": start.check_start,
    "again": check_again,
}
# Parts of the long form: minutes of compilation, and figures that are printed and not checked.
LONG = () if os.environ.get("MLSWARP_TESTS_FULL") == "1" else ("again", "scaling")
