"""PNG images, decoded independently of the program."""

import contextlib
import zlib

from commands import ROOT, Failure

# A pixel counts as moved if a channel differs by more than rounding errors.
MOVED_LEVEL = 8


def decode_png(data):
    """(width, height, RGBA bytes) of an 8-bit RGB or RGBA picture without interlacing; refuses all
    others."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise Failure(f"not a PNG: it begins with {data[:16]!r}")
    at, packed, header = 8, b"", None
    while at < len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        body = data[at + 8 : at + 8 + length]
        if zlib.crc32(kind + body) != int.from_bytes(
            data[at + 8 + length : at + 12 + length], "big"
        ):
            raise Failure(f"the PNG's chunk {kind!r} has a wrong checksum")
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            packed += body
        at += 12 + length
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    depth, colour, interlace = header[8], header[9], header[12]
    channels = {2: 3, 6: 4}.get(colour)
    if depth != 8 or channels is None or interlace:
        raise Failure(
            f"a PNG of depth {depth}, colour type {colour}, interlace {interlace} is not read here"
        )
    lines, stride = zlib.decompress(packed), width * channels
    pixels, above = bytearray(), bytes(stride)
    for y in range(height):
        kind, line = (
            lines[y * (stride + 1)],
            bytearray(lines[y * (stride + 1) + 1 : (y + 1) * (stride + 1)]),
        )
        for x in range(stride) if kind else ():
            left = line[x - channels] if x >= channels else 0
            up, corner = above[x], above[x - channels] if x >= channels else 0
            if kind == 4:
                estimate = left + up - corner
                far = (abs(estimate - left), abs(estimate - up), abs(estimate - corner))
                guess = (left, up, corner)[far.index(min(far))]
            else:
                guess = (0, left, up, (left + up) // 2)[kind]
            line[x] = (line[x] + guess) & 255
        above = bytes(line)
        pixels += above
    if channels == 3:
        rgba = bytearray(b"\xff" * (width * height * 4))
        for channel in range(3):
            rgba[channel::4] = pixels[channel::3]
        pixels = rgba
    return width, height, bytes(pixels)


def moved_share(one, other):
    """The share of visibly different pixels of two images of equal size."""
    moved = sum(
        any(abs(a - b) > MOVED_LEVEL for a, b in zip(one[i : i + 4], other[i : i + 4]))
        for i in range(0, len(one), 4)
    )
    return moved / (len(one) // 4)


def photograph():
    """The smallest photograph of the tests, for fast decoding."""
    pictures = sorted((ROOT / "tests/images").glob("*.png"), key=lambda p: p.stat().st_size)
    for picture in pictures:
        with contextlib.suppress(Failure):
            width, height, pixels = decode_png(picture.read_bytes())
            if width * height >= 50_000 and min(pixels[3::4]) == 255:
                return picture, width, height, pixels
    raise Failure("tests/images holds no opaque 8-bit PNG photograph")
