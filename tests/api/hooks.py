"""Images for the generated requests: the small files of tests/fuzz/seeds, two of them damaged, and bytes that are not an image."""

from pathlib import Path

import schemathesis
from hypothesis import strategies

SEEDS = Path(__file__).parent.parent / "fuzz" / "seeds" / "image"
REAL = [file.read_bytes() for file in sorted(SEEDS.iterdir())]
DAMAGED = [REAL[0][:-20], REAL[-1][:100], b"GIF89a\x01\0\x01\0", b""]

# Sixteen valid files per invalid one: most requests should pass the image check.
schemathesis.openapi.format("binary", strategies.sampled_from(REAL + DAMAGED))
