#!/usr/bin/env python3
"""Writes tests/fuzz/seeds/image: one small real file of every kind that is read, and of some that
are not, and small hostile ones.

    pip install pillow==13.0.0
    tests/fuzz/seeds.py

The files are kept in git; this is how they were made. PNG chunk by chunk, because encoders choose
for themselves; JPEG by libjpeg-turbo and WebP by libwebp, TIFF by libtiff, GIF and BMP, all through
Pillow, so that what is mutated is what real encoders write.
"""

import io
import math
import struct
import zlib
from pathlib import Path

from PIL import Image, ImageCms

SEEDS = Path(__file__).parent / "seeds" / "image"
WIDTH, HEIGHT = 24, 17


def sample(x, y, c):
    wave = 90 * math.sin(x * (c + 1) / 5) * math.cos(y / (4 + c))
    return max(0, min(255, int(128 + wave + (x * 31 + y * 17 + c * 7) % 13)))


def photo(width, height, mode):
    image = Image.new(mode, (width, height))
    count = len(image.getbands())
    image.putdata(
        [
            tuple(sample(x, y, c) for c in range(count)) if count > 1 else sample(x, y, 0)
            for y in range(height)
            for x in range(width)
        ]
    )
    return image


def exif(orientation):
    return (
        b"Exif\0\0"
        + b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0"
        + struct.pack("<HH", orientation, 0)
        + bytes(4)
    )


PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


ADAM7 = [
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
]
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def packed(width, bits, colour, xs, y):
    """A row of samples, each of `bits` bits, filter 0 to 4 by the row's number; only filters 0 and
    1 are really applied."""
    numbers = [
        sample(x, y, c) * ((1 << bits) - 1) // 255 for x in xs for c in range(CHANNELS[colour])
    ]
    text = "".join(f"{number:0{bits}b}" for number in numbers)
    text += "0" * (-len(text) % 8)
    row = bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
    step = max(1, bits * CHANNELS[colour] // 8)
    if y % 2:
        return b"\1" + bytes(
            (value - (row[i - step] if i >= step else 0)) % 256 for i, value in enumerate(row)
        )
    return b"\0" + row


def png(bits, colour, interlaced=False, before=(), after=(), parts=1):
    passes = ADAM7 if interlaced else [(0, 0, 1, 1)]
    rows = b""
    for x0, y0, dx, dy in passes:
        xs = range(x0, WIDTH, dx)
        if xs:
            rows += b"".join(packed(len(xs), bits, colour, xs, y) for y in range(y0, HEIGHT, dy))
    data = zlib.compress(rows, 9)
    cut = -(-len(data) // parts)
    out = b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, bits, colour, 0, 0, interlaced)
    )
    if colour == 3:
        before = [
            (b"PLTE", bytes((i * k) % 256 for i in range(1 << bits) for k in (37, 91, 153))),
            *before,
        ]
    out += b"".join(chunk(kind, data) for kind, data in before)
    out += b"".join(chunk(b"IDAT", data[i : i + cut]) for i in range(0, len(data), cut))
    out += b"".join(chunk(kind, data) for kind, data in after)
    return out + chunk(b"IEND", b"")


def pngs():
    for colour, depths in {
        0: (1, 2, 4, 8, 16),
        2: (8, 16),
        3: (1, 2, 4, 8),
        4: (8, 16),
        6: (8, 16),
    }.items():
        for bits in depths:
            yield f"png-{colour}-{bits}", png(bits, colour)
    for colour, bits in ((0, 1), (2, 8), (3, 4), (6, 16)):
        yield f"png-{colour}-{bits}-interlaced", png(bits, colour, interlaced=True)
    yield "png-palette-transparent", png(4, 3, before=[(b"tRNS", bytes(range(0, 160, 10)))])
    yield "png-grey-transparent", png(2, 0, before=[(b"tRNS", b"\0\2")])
    yield "png-rgb-transparent", png(16, 2, before=[(b"tRNS", struct.pack(">HHH", 1, 2, 3))])
    rich = [
        (b"gAMA", struct.pack(">I", 45455)),
        (b"cHRM", struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)),
        (b"iCCP", b"sRGB\0\0" + zlib.compress(PROFILE, 9)),
        (b"eXIf", exif(6)[6:]),
        (b"tEXt", b"Title\0a small picture"),
        (b"zTXt", b"Comment\0\0" + zlib.compress(b"words " * 40)),
        (b"iTXt", b"Author\0\1\0en\0\0" + zlib.compress(b"someone")),
        (b"pHYs", struct.pack(">IIB", 2835, 2835, 1)),
    ]
    yield (
        "png-rich",
        png(
            8,
            6,
            before=rich,
            after=[(b"tIME", struct.pack(">HBBBBB", 2024, 1, 2, 3, 4, 5))],
            parts=3,
        ),
    )
    control = struct.pack(">IIIIIHHBB", 0, WIDTH, HEIGHT, 0, 0, 1, 10, 0, 0)
    yield (
        "png-animated-1",
        png(8, 2, before=[(b"acTL", struct.pack(">II", 1, 0)), (b"fcTL", control)]),
    )
    frame = zlib.compress(b"".join(packed(WIDTH, 8, 2, range(WIDTH), y) for y in range(HEIGHT)), 9)
    second = [
        (b"fcTL", struct.pack(">I", 1) + control[4:]),
        (b"fdAT", struct.pack(">I", 2) + frame),
    ]
    yield (
        "png-animated-2",
        png(8, 2, before=[(b"acTL", struct.pack(">II", 2, 0)), (b"fcTL", control)], after=second),
    )


def written(image, kind, **options):
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


def jpegs():
    rgb, grey, cmyk = (photo(40, 33, mode) for mode in ("RGB", "L", "CMYK"))
    yield "jpeg-444", written(rgb, "JPEG", quality=60, subsampling=0)
    yield "jpeg-422", written(rgb, "JPEG", quality=60, subsampling=1)
    yield "jpeg-420", written(rgb, "JPEG", quality=60, subsampling=2, optimize=True)
    yield "jpeg-grey", written(grey, "JPEG", quality=60)
    yield "jpeg-cmyk", written(cmyk, "JPEG", quality=60)
    yield "jpeg-rgb", written(rgb, "JPEG", quality=60, keep_rgb=True)
    yield "jpeg-restart", written(rgb, "JPEG", quality=60, restart_marker_blocks=2)
    yield "jpeg-progressive", written(rgb, "JPEG", quality=60, progressive=True)
    yield (
        "jpeg-progressive-420",
        written(rgb, "JPEG", quality=60, progressive=True, subsampling=2, restart_marker_rows=1),
    )
    yield "jpeg-progressive-grey", written(grey, "JPEG", quality=60, progressive=True)
    yield "jpeg-progressive-cmyk", written(cmyk, "JPEG", quality=60, progressive=True)
    for orientation in (1, 3, 6, 8):
        yield f"jpeg-turned-{orientation}", written(rgb, "JPEG", quality=30, exif=exif(orientation))
    yield (
        "jpeg-profile",
        written(rgb, "JPEG", quality=30, icc_profile=PROFILE, comment=b"a comment"),
    )


def webps():
    rgb, rgba = photo(40, 33, "RGB"), photo(40, 33, "RGBA")
    few = rgb.quantize(12).convert("RGB")
    yield "webp-lossy", written(rgb, "WEBP", quality=50)
    yield "webp-lossy-alpha", written(rgba, "WEBP", quality=50, alpha_quality=60)
    yield "webp-lossy-rich", written(rgb, "WEBP", quality=50, exif=exif(5), icc_profile=PROFILE)
    yield "webp-lossless", written(rgb, "WEBP", lossless=True, method=6)
    yield "webp-lossless-alpha", written(rgba, "WEBP", lossless=True, method=0)
    yield "webp-lossless-palette", written(few, "WEBP", lossless=True, method=6)
    yield (
        "webp-lossless-rich",
        written(few, "WEBP", lossless=True, exif=exif(7), icc_profile=PROFILE),
    )
    # Large enough that the encoder divides it into regions with codes of their own.
    halves = Image.new("RGB", (96, 96))
    halves.paste(photo(96, 48, "RGB"), (0, 0))
    halves.paste(photo(96, 48, "RGB").quantize(30).convert("RGB").rotate(90, expand=True), (0, 48))
    yield "webp-lossless-regions", written(halves, "WEBP", lossless=True, quality=100, method=6)
    yield "webp-animated-1", one_frame(written(rgba, "WEBP", lossless=True))
    yield (
        "webp-animated-2",
        written(rgb, "WEBP", save_all=True, append_images=[rgb.rotate(180)], duration=50),
    )


def tiffs():
    rgb, rgba, grey = (
        photo(WIDTH, HEIGHT, "RGB"),
        photo(WIDTH, HEIGHT, "RGBA"),
        photo(WIDTH, HEIGHT, "L"),
    )
    deep = Image.new("I;16", (WIDTH, HEIGHT))
    deep.putdata([sample(x, y, 0) * 256 + x * 7 + y for y in range(HEIGHT) for x in range(WIDTH)])
    yield "tiff-rgb", written(rgb, "TIFF")
    yield "tiff-rgb-lzw", written(rgb, "TIFF", compression="tiff_lzw", tiffinfo={317: 2})
    yield (
        "tiff-rgb-deflate",
        written(rgb, "TIFF", compression="tiff_adobe_deflate", tiffinfo={317: 2}),
    )
    yield "tiff-rgb-packbits", written(rgb, "TIFF", compression="packbits")
    yield (
        "tiff-rgb-rich",
        written(rgb, "TIFF", compression="tiff_lzw", icc_profile=PROFILE, tiffinfo={274: 6}),
    )
    yield "tiff-rgba-lzw", written(rgba, "TIFF", compression="tiff_lzw")
    yield "tiff-grey", written(grey, "TIFF", compression="tiff_lzw")
    yield "tiff-grey-alpha", written(photo(WIDTH, HEIGHT, "LA"), "TIFF", compression="tiff_lzw")
    yield "tiff-grey-16", written(deep, "TIFF", compression="tiff_adobe_deflate")
    yield "tiff-grey-1", written(grey.convert("1"), "TIFF")
    yield "tiff-palette", written(rgb.quantize(12), "TIFF", compression="packbits")
    yield "tiff-cmyk", written(photo(WIDTH, HEIGHT, "CMYK"), "TIFF")
    yield "tiff-two-pages", written(grey, "TIFF", save_all=True, append_images=[grey])


def gifs_and_bmps():
    rgb, rgba = photo(WIDTH, HEIGHT, "RGB"), photo(WIDTH, HEIGHT, "RGBA")
    yield "gif", written(rgb.quantize(12), "GIF")
    yield (
        "gif-interlaced-transparent",
        written(rgb.quantize(12), "GIF", interlace=1, transparency=3),
    )
    yield (
        "gif-animated",
        written(
            rgb.quantize(12),
            "GIF",
            save_all=True,
            append_images=[rgb.rotate(180).quantize(12)],
            duration=50,
        ),
    )
    yield "bmp-1", written(rgb.convert("1"), "BMP")
    yield "bmp-8", written(rgb.quantize(12), "BMP")
    yield "bmp-24", written(rgb, "BMP")
    yield "bmp-32", written(rgba, "BMP")


def one_frame(still):
    """An animation of one frame, in the container of a still picture's chunk."""
    at = still.index(b"VP8L")
    length = struct.unpack("<I", still[at + 4 : at + 8])[0]
    picture = still[at : at + 8 + length + length % 2]
    size = (40 - 1).to_bytes(3, "little") + (33 - 1).to_bytes(3, "little")
    frame = bytes(6) + size + bytes(4) + picture
    chunks = b"VP8X" + struct.pack("<I", 10) + b"\x12\0\0\0" + size
    chunks += b"ANIM" + struct.pack("<I", 6) + bytes(6)
    chunks += b"ANMF" + struct.pack("<I", len(frame)) + frame
    return b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WEBP" + chunks


def bits(*fields):
    """Numbers with this number of bits each, lowest first."""
    number = place = 0
    for value, count in fields:
        number |= value << place
        place += count
    return number.to_bytes(-(-place // 8) + 16, "little")


def riff(*chunks):
    body = b"".join(
        kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2) for kind, data in chunks
    )
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


def hostile():
    """Small files whose work an unwary reader multiplies by the sizes that they claim."""
    zero, head = (0b0001, 4), (0x2F, 8)
    # A prefix code whose one symbol lies beyond the literals.
    far = [(0, 5), (0, 3), (1, 3), (0, 3), (1, 3), (1, 1), (0, 3), (2, 2), *[(1, 1), (89, 7)] * 2]
    copy = [*far, (1, 1), (45, 7), (0, 1)]
    cached = [*far, (1, 1), (69, 7), (0, 1)]
    size = lambda width, height: [head, (width - 1, 14), (height - 1, 14), (0, 4)]
    copies = [(0b001, 3), (0, 3), (0, 1), *copy, *[zero] * 4]
    yield "webp-transform-of-copies", riff((b"VP8L", bits(*size(4096, 256), *copies)))
    transform = [(0b001, 3), (0, 3), (0b00011, 5), *cached, *[zero] * 4]
    yield "webp-transforms-30", riff((b"VP8L", bits(*size(4096, 256), *transform * 30)))
    # The frame is that of a real file, and so is its size.
    lossy = (SEEDS / "webp-lossy").read_bytes()[20:]
    canvas = b"\x10\0\0\0" + (40 - 1).to_bytes(3, "little") + (33 - 1).to_bytes(3, "little")
    alpha = b"\1" + bits(*transform * 30)
    yield "webp-alpha-transforms-30", riff((b"VP8X", canvas), (b"ALPH", alpha), (b"VP8 ", lossy))
    plain = [(0, 1), (0b11, 2), (0, 3), (0, 1), *cached, *[zero] * 4]
    yield "webp-one-cached-colour", riff((b"VP8L", bits(*size(256, 256), *plain)))
    rows = b"".join(packed(WIDTH, 8, 2, range(WIDTH), y) for y in range(HEIGHT))
    last = (
        b"\1"
        + struct.pack("<HH", len(rows), 0xFFFF - len(rows))
        + rows
        + struct.pack(">I", zlib.adler32(rows))
    )
    start = b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0)
    )
    end = chunk(b"IEND", b"")
    behind = b"\x78\x01" + b"\0\0\0\xff\xff" * 400 + last
    yield "png-empty-blocks", start + chunk(b"IDAT", behind) + end
    yield (
        "png-empty-chunks",
        start + chunk(b"IDAT", b"") * 200 + chunk(b"IDAT", b"\x78\x01" + last) + end,
    )
    yield (
        "png-profile-empty-blocks",
        start + chunk(b"iCCP", b"name\0\0" + behind) + chunk(b"IDAT", b"\x78\x01" + last) + end,
    )


def main():
    SEEDS.mkdir(parents=True, exist_ok=True)
    for kind in (pngs, jpegs, webps, tiffs, gifs_and_bmps, hostile):
        for name, data in kind():
            (SEEDS / name).write_bytes(data)
    files = list(SEEDS.iterdir())
    print(f"{len(files)} files, {sum(file.stat().st_size for file in files)} bytes")


if __name__ == "__main__":
    main()
