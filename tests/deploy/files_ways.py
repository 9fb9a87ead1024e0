"""Runs the first block for Kubernetes in deploy/README.md as it is written there, with a `kubectl`
that needs no cluster: it renders what would be created or applied. The objects must keep to their
schemas and contain every Secret that they refer to."""

import shutil
import subprocess
import tempfile
from pathlib import Path

import yaml

from files_kubernetes import FOLDER, by_schema, name_of
from readme_commands import block

# `create` prints the object and sends nothing; `apply -k` becomes the rendering. Every call is
# recorded.
KUBECTL = """#!/bin/sh
set -e
echo "$*" >> "$KUBECTL_CALLS"
case "$*" in
    *"create "*) REAL "$@" --dry-run=client --output yaml ;;
    "apply -k "*) REAL kustomize "$3" ;;
    *"rollout status "*) exit 0 ;;
    *) echo "unexpected: kubectl $*" >&2; exit 1 ;;
esac >> "$KUBECTL_OBJECTS"
echo --- >> "$KUBECTL_OBJECTS"
"""


def run_block(script):
    """(error, objects, calls of kubectl) of the commands, in a copy of the files that they need."""
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        shutil.copytree(FOLDER, here / FOLDER)
        certificate = (
            "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "
            "/CN=test -days 1 -keyout key.pem -out cert.pem"
        )
        subprocess.run(certificate.split(), cwd=here, check=True, capture_output=True)
        (here / "bin").mkdir()
        (here / "bin/kubectl").write_text(KUBECTL.replace("REAL", shutil.which("kubectl")))
        (here / "bin/kubectl").chmod(0o755)
        files = {"KUBECTL_CALLS": here / "calls", "KUBECTL_OBJECTS": here / "objects"}
        env = {
            "PATH": f"{here}/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            **{name: str(file) for name, file in files.items()},
        }
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=here,
            env=env,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            return f"exit {done.returncode}: {done.stderr}", [], []
        objects = [o for o in yaml.safe_load_all(files["KUBECTL_OBJECTS"].read_text()) if o]
        return None, objects, files["KUBECTL_CALLS"].read_text().splitlines()


def wanted(tree):
    """(name, key) of every Secret that the objects refer to; the key is None if all of it is."""
    if isinstance(tree, list):
        return set().union(*map(wanted, tree))
    if not isinstance(tree, dict):
        return set()
    own = (
        {(tree["secretName"], item["key"]) for item in tree.get("items", [])}
        if "secretName" in tree
        else set()
    )
    own |= (
        {(tree["secretKeyRef"]["name"], tree["secretKeyRef"]["key"])}
        if "secretKeyRef" in tree
        else set()
    )
    own |= {(ref["name"], None) for ref in tree.get("certificateRefs", [])}
    return own.union(*map(wanted, tree.values()))


def lacking(objects):
    """Secrets, and keys in them, that are referred to and not created."""
    made = {o["metadata"]["name"]: o["data"] for o in objects if o["kind"] == "Secret"}
    absent = [
        (name, key)
        for name, key in wanted(objects)
        if name not in made or key and key not in made[name]
    ]
    return [f"no Secret {name}{f' with {key}' if key else ''}" for name, key in absent]


def check(kept):
    """Runs all checks; yields (name, messages)."""
    script = block("Kubernetes")
    error, objects, calls = run_block(script)
    yield (
        "the commands for Kubernetes in deploy/README.md succeed, without a cluster",
        [error] if error else [],
    )
    yield (
        f"their {len(objects)} objects keep to their schemas",
        [c for said in by_schema(objects, kept) for c in said],
    )
    yield "they make every Secret", lacking(objects)
    values = dict(word.split("=", 1) for word in script.splitlines()[0].split() if "=" in word)
    rendered = yaml.safe_dump_all(objects)
    said = [
        f"{name} is not used: {value}" for name, value in values.items() if value not in rendered
    ]
    for o in objects:
        if (
            o["kind"] in ("Gateway", "HTTPRoute")
            and "warp.example.com" in str(o)
            or "registry.example/" in str(o)
        ):
            said.append(f"{name_of(o)} has a value of the example")
    yield "host name, image and network are those of the first line", said
    waited = calls[-1].split()[-2:]
    found = [o for o in objects if (o["kind"].lower(), o["metadata"]["name"]) == tuple(waited)]
    yield (
        "they wait for a workload that they apply",
        [] if len(found) == 1 else [f"{' '.join(waited)}: {len(found)}"],
    )
    without = "\n".join(line for line in script.splitlines() if "secret generic valkey" not in line)
    yield (
        "a missing Secret is seen",
        [] if lacking(run_block(without)[1]) else ["the Secret of the store is not missed"],
    )
