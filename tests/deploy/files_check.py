"""Runs every check of the files in deploy/ (see `files`): prints the results, and exits with 1
after a failure."""

import subprocess
import sys
import traceback
from pathlib import Path

import files_kubernetes
import files_systemd
import files_ways


def tracked(*patterns):
    return subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *patterns],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split("\0")[:-1]


def silent(*command):
    """Messages of a linter that failed."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return (
        [done.stdout.strip() or f"{command[0]} ended with {done.returncode}"]
        if done.returncode
        else []
    )


def shell_scripts():
    for name in tracked():
        try:
            with open(name, "rb") as file:
                head = file.read(64)
        except OSError:
            continue
        if head.startswith(b"#!") and b"sh" in head.split(b"\n")[0].split(b"/")[-1]:
            yield name


def linters():
    """General-purpose linters."""
    # DL4006 requires a shell with `pipefail`, which a builder may lack; cargo rejects an empty
    # result of the only pipe.
    yield (
        "hadolint has nothing to say",
        silent(
            "hadolint",
            "--no-color",
            "--failure-threshold",
            "style",
            "--ignore",
            "DL4006",
            "deploy/Dockerfile",
        ),
    )
    scripts = sorted(shell_scripts())
    yield (
        f"shellcheck has nothing to say of {len(scripts)} scripts",
        silent("shellcheck", "-x", *scripts),
    )
    # Style rules are off: line length, spaces. The default rules report duplicate keys.
    rules = (
        "{extends: default, rules: {line-length: disable, document-start: disable, comments: "
        "disable, comments-indentation: disable, braces: {max-spaces-inside: 1}, truthy: "
        "{check-keys: false}}}"
    )
    files = tracked("*.yaml", "*.yml")
    yield (
        f"yamllint has nothing to say of {len(files)} files",
        silent("yamllint", "--strict", "-d", rules, *files),
    )


def simulation():
    yield (
        "the simulation of affinity keeps its laws",
        silent(sys.executable, "tests/bench/affinity.py", "--check"),
    )


def main(kept):
    held = failed = 0
    for checks in (
        linters(),
        simulation(),
        files_systemd.check(),
        files_kubernetes.check(Path(kept)),
        files_ways.check(Path(kept)),
    ):
        try:
            for what, complaints in checks:
                print(f"{'FAILED' if complaints else '  held'}: {what}", flush=True)
                for complaint in complaints:
                    print(f"      {complaint}", flush=True)
                failed += bool(complaints)
                held += not complaints
        except Exception:  # a check that cannot run has failed, and the others still run
            traceback.print_exc()
            failed += 1
    print(f"files: {held} checks held, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
