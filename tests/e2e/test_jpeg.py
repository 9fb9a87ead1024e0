"""The service's JPEG files in independent decoders: libjpeg-turbo (Pillow and cv2), FFmpeg (PyAV)
and Chromium. The Rust tests have two more."""

import base64
import io
import json
import warnings

import av
import cv2
import httpx
import numpy
import pytest
from PIL import Image

# Small, one macroblock and a pixel, several strips.
SIZES = [(1, 1), (8, 9), (17, 16), (33, 40), (500, 375)]
CASES = [(quality, sampling) for quality in (1, 50, 85, 100) for sampling in ("4:2:0", "4:4:4")]

DECODE = """async file => {
  const bytes = Uint8Array.from(atob(file), character => character.charCodeAt(0))
  const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }))
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height)
  const context = canvas.getContext("2d")
  context.drawImage(bitmap, 0, 0)
  const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height)
  const text = Array.from(data, byte => String.fromCharCode(byte)).join("")
  return [bitmap.width, bitmap.height, btoa(text)]
}"""


def waves(size, grey):
    """Smooth, with noise in a corner, so that codes of every length occur."""
    y, x = numpy.mgrid[: size[1], : size[0]]
    channels = [
        127 + 110 * numpy.sin(0.05 * x + c) * numpy.cos(0.04 * y - c)
        for c in range(1 if grey else 3)
    ]
    picture = numpy.stack(channels, axis=2).round().astype(numpy.uint8)
    corner = picture[: size[1] // 4, : size[0] // 4]
    corner[:] = numpy.random.default_rng(size[0]).integers(0, 256, corner.shape, numpy.uint8)
    return picture[..., 0] if grey else picture


def jpeg(server, picture, quality, sampling):
    """The picture, not moved, as the service writes it."""
    png = io.BytesIO()
    Image.fromarray(picture).save(png, "png")
    warp = {
        "p": [[0, 0]],
        "q": [[0, 0]],
        "output": {"format": "jpeg", "quality": quality, "subsampling": sampling},
    }
    answer = httpx.post(
        f"{server.address}/warp", files={"image": png.getvalue(), "warp": (None, json.dumps(warp))}
    )
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/jpeg"
    return answer.content


def ffmpeg(file):
    av.logging.set_level(av.logging.WARNING)
    with (
        av.logging.Capture() as messages,
        av.open(io.BytesIO(file), format="jpeg_pipe") as container,
    ):
        frame = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert not [message for message in messages if "deprecated pixel format" not in message[2]], (
        messages
    )
    return frame


def pillow(file):
    with warnings.catch_warnings(action="error"), Image.open(io.BytesIO(file)) as image:
        assert "progressive" not in image.info
        return numpy.asarray(image.convert("RGB"))


def chromium(visit, file):
    width, height, data = visit.page.evaluate(DECODE, base64.b64encode(file).decode())
    return numpy.frombuffer(base64.b64decode(data), numpy.uint8).reshape(height, width, 4)[..., :3]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
def test_decoders_agree(visit, server, size, grey):
    picture = waves(size, grey)
    for quality, sampling in CASES:
        file = jpeg(server, picture, quality, sampling)
        reference = pillow(file).astype(int)
        assert reference.shape == (size[1], size[0], 3)
        others = {
            "cv2": cv2.cvtColor(
                cv2.imdecode(numpy.frombuffer(file, numpy.uint8), cv2.IMREAD_COLOR),
                cv2.COLOR_BGR2RGB,
            ),
            "FFmpeg": ffmpeg(file),
            "Chromium": chromium(visit, file),
        }
        for name, other in others.items():
            apart = numpy.abs(other.astype(int) - reference)
            # They enlarge chrominance of half the resolution in different ways.
            figure, limit = (apart.max(), 6) if grey or sampling == "4:4:4" else (apart.mean(), 4)
            assert figure <= limit, (name, quality, sampling, figure)
        if quality == 100 and (grey or sampling == "4:4:4"):
            of = numpy.repeat(picture[..., None], 3, axis=2) if grey else picture
            assert numpy.abs(reference - of).max() <= 4
