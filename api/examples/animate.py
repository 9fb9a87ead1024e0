#!/usr/bin/env python3
"""Makes an animated WebP of a warp: the image deforms from its rest pose to the posed handles and
back.

    api/examples/animate.py IMAGE WARP.json OUT.webp [PROGRAM]

IMAGE is an image, WARP.json a warp object with p and q in px (api/examples has five). `mlswarp
warp` renders every frame; PROGRAM is target/release/mlswarp by default. Requires Pillow. The
animation at the top of README.md:

    api/examples/animate.py tests/images/astronaut.png api/examples/thinner-face.json \\
        api/examples/drag.webp
"""

import io
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw

STEPS = 24
WIDTH = 320
FRAME_MS = 60


def between(p, q, t):
    """Interpolates between p and q, nested lists of numbers."""
    return [between(a, b, t) for a, b in zip(p, q)] if isinstance(p, list) else p + t * (q - p)


def handles(places):
    """The points of all handles."""
    return (
        [places]
        if not isinstance(places[0], list)
        else [point for place in places for point in handles(place)]
    )


def frame(program, image, warp, t, folder):
    """The image at the fraction t of the way from p to q, with its handles."""
    posed = between(warp["p"], warp["q"], t)
    output = {**warp.get("output", {}), "width": WIDTH}
    Path(folder, "warp.json").write_text(json.dumps({**warp, "q": posed, "output": output}))
    subprocess.run(
        [program, "warp", image, f"{folder}/warp.json", "-o", f"{folder}/frame.png"],
        check=True,
        stderr=subprocess.DEVNULL,
    )
    picture = Image.open(io.BytesIO(Path(folder, "frame.png").read_bytes())).convert("RGBA")
    scale = picture.width / Image.open(image).width
    draw = ImageDraw.Draw(picture)
    for x, y in handles(posed):
        x, y = x * scale, y * scale
        draw.ellipse((x - 4, y - 4, x + 4, y + 4), fill="#ffd23f", outline="#1b1b1e")
    white = Image.new("RGBA", picture.size, "white")
    return Image.alpha_composite(white, picture).convert("RGB")


def main():
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    image, warp, out = sys.argv[1], json.loads(Path(sys.argv[2]).read_text()), sys.argv[3]
    program = sys.argv[4] if len(sys.argv) == 5 else "target/release/mlswarp"
    with tempfile.TemporaryDirectory() as folder:
        times = [(1 - math.cos(2 * math.pi * k / STEPS)) / 2 for k in range(STEPS)]
        frames = [frame(program, image, warp, t, folder) for t in times]
    frames[0].save(
        out,
        save_all=True,
        append_images=frames[1:],
        duration=FRAME_MS,
        loop=0,
        quality=70,
        method=6,
    )


main()
