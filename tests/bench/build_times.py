#!/usr/bin/env python3
"""Times of builds: from scratch, and after a change of one method, one route, one sentence.

    tests/bench/build_times.py [--dev]

Builds the program in a folder of its own, which is removed afterwards. A change is a new time of a
file, for which cargo compiles the same crates as for a new line in it; the next build in `target`
compiles them again. Seconds of a processor depend less on what else runs than elapsed ones.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHANGES = {
    "one method": "src/engine/deform/methods/global_affine.rs",
    "one sentence": "src/contract/problem/sentences.rs",
    "one route": "src/server/http/routes/warp.rs",
}


def processor_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def build(folder, profile):
    began, used = time.monotonic(), processor_seconds()
    command = ["cargo", "build", "--quiet", "--locked", "-p", "mlswarp-server", *profile]
    subprocess.run([*command, "--target-dir", folder], cwd=ROOT, check=True)
    elapsed, used = time.monotonic() - began, processor_seconds() - used
    return f"{elapsed:.1f} s, {used:.1f} s of a processor"


def main():
    profile = [] if "--dev" in sys.argv[1:] else ["--release"]
    with tempfile.TemporaryDirectory() as folder:
        print(f"build: from scratch: {build(folder, profile)}", flush=True)
        for name, path in CHANGES.items():
            os.utime(ROOT / path)
            print(f"build: after a change of {name} ({path}): {build(folder, profile)}", flush=True)


if __name__ == "__main__":
    main()
