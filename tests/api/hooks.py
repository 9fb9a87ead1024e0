"""Images for the generated requests: the small files of tests/fuzz/seeds, two of them damaged, and
bytes that are not an image. Requests in which the value of a field is `null` are left out: the
schemas call them invalid, and the server takes them (tests/it/json_null.rs)."""

from pathlib import Path

import schemathesis
from hypothesis import strategies

SEEDS = Path(__file__).parent.parent / "fuzz" / "seeds" / "image"
REAL = [file.read_bytes() for file in sorted(SEEDS.iterdir())]
DAMAGED = [REAL[0][:-20], REAL[-1][:100], b"GIF89a\x01\0\x01\0", b""]

# Sixteen valid files per invalid one: most requests should pass the image check.
schemathesis.openapi.format("binary", strategies.sampled_from(REAL + DAMAGED))


def has_null_field(value):
    if isinstance(value, dict):
        return any(inner is None or has_null_field(inner) for inner in value.values())
    return isinstance(value, list) and any(map(has_null_field, value))


# Not `filter_body`, which the phase "coverage" does not ask.
@schemathesis.hook
def filter_case(context, case):
    return not has_null_field(case.body)
