#!/usr/bin/env python3
"""Checks blends against numpy, and times them beside single warps.

    tests/bench/blend.py PROGRAM [IMAGES]

numpy adds in double precision what `POST /warp` draws with `compression: none`; the largest
difference is printed in units of a sample. Then 50 images of 1 megapixel (or IMAGES) are sessions:
one blend of all beside as many warps, in turns, with images that stay decoded and with a cache that
keeps none; and the most resident memory of a blend by its number of images.
Both share the machine with the program: only the ratios mean something.

It needs numpy and Pillow, which the environment of the browser tests has:
tests/artefacts/e2e/venv/bin/python tests/bench/blend.py target/release/mlswarp
"""

import http.client
import io
import itertools
import json
import pathlib
import re
import socket
import statistics
import struct
import subprocess
import sys
import time
import zlib

import numpy
from PIL import Image

PHOTO = pathlib.Path(__file__).parent.parent / "images" / "astronaut.png"
JSON = {"Content-Type": "application/json"}
ROUNDS = 5
HEIGHT, WIDTH = 868, 1152


class Program:
    """A running program and one connection to it."""

    def __init__(self, path, *options):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = [path, "--listen", f"127.0.0.1:{port}", "--log", "off", *options]
        self.process = subprocess.Popen(command)
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
        while True:
            try:
                self.ask("GET", "/readyz")
                return
            except OSError:
                self.connection.close()
                time.sleep(0.02)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()

    def ask(self, method, path, body=None, headers=None):
        self.connection.request(method, path, body, headers or {})
        answer = self.connection.getresponse()
        content = answer.read()
        assert answer.status < 300, content[:500]
        return content

    def post(self, path, value):
        return self.ask("POST", path, json.dumps(value), JSON)

    def form(self, path, parts):
        lines = []
        for name, content in parts:
            head = f'--x\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'
            lines += [head.encode(), content, b"\r\n"]
        body = b"".join([*lines, b"--x--\r\n"])
        return self.ask("POST", path, body, {"Content-Type": "multipart/form-data; boundary=x"})

    def decoded(self):
        text = self.ask("GET", "/metrics").decode()
        return int(re.search(r'builds_total\{cache="images"\} (\d+)', text)[1])

    def memory(self, name):
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(rf"{name}:\s+(\d+) kB", status)[1]) / 1024


def written(samples):
    """A PNG of [height, width, 3 or 4] samples of 8 or 16 bits."""
    height, width, channels = samples.shape
    size = samples.dtype.itemsize
    rows = samples.astype(f">u{size}").tobytes()
    step = width * channels * size
    rows = b"".join(b"\0" + rows[k : k + step] for k in range(0, len(rows), step))

    def chunk(name, data):
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8 * size, {3: 2, 4: 6}[channels], 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def read(file):
    """The samples of a PNG that `compression: none` has written."""
    at, data = 8, b""
    while at < len(file):
        (length,) = struct.unpack(">I", file[at : at + 4])
        name, content = file[at + 4 : at + 8], file[at + 8 : at + 8 + length]
        if name == b"IHDR":
            width, height, bits, kind = struct.unpack(">IIBB", content[:10])
        elif name == b"IDAT":
            data += content
        at += length + 12
    channels, size = {0: 1, 2: 3, 4: 2, 6: 4}[kind], bits // 8
    rows = numpy.frombuffer(zlib.decompress(data), numpy.uint8).reshape(height, -1)
    assert not rows[:, 0].any(), "rows without a filter"
    samples = numpy.frombuffer(rows[:, 1:].tobytes(), f">u{size}")
    samples = samples.reshape(height, width, channels)
    if channels < 3:
        samples = numpy.concatenate([samples[..., :1].repeat(3, 2), samples[..., 1:]], 2)
    return samples.astype(numpy.float64) / (2**bits - 1)


def light(values):
    return numpy.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def samples_of(values):
    powers = 1.055 * numpy.maximum(values, 0) ** (1 / 2.4) - 0.055
    return numpy.where(values <= 0.0031308, values * 12.92, powers)


def by_numpy(warped, weights, is_linear):
    """Colours and alpha, by the rules of MATHEMATICS.md, section 15."""
    images = [image if image.shape[2] == 4 else with_alpha(image) for image in warped]
    colours = [light(image[..., :3]) if is_linear else image[..., :3] for image in images]
    alphas = [image[..., 3:] for image in images]
    if min(weights) < 0:
        colour = sum(b * c for b, c in zip(weights, colours))
        alpha = numpy.minimum.reduce(alphas)
    else:
        alpha = sum(b * a for b, a in zip(weights, alphas))
        total = sum(b * a * c for b, a, c in zip(weights, alphas, colours))
        colour = numpy.divide(total, alpha, where=alpha > 0, out=numpy.zeros_like(total))
    colour = samples_of(colour) if is_linear else colour
    return numpy.concatenate([colour, alpha], 2).clip(0, 1)


def with_alpha(image):
    return numpy.concatenate([image, numpy.ones_like(image[..., :1])], 2)


def agreement(program):
    """Blends of three images by the program and by numpy."""
    random = numpy.random.default_rng(41)
    grid = numpy.mgrid[0:120, 0:160]
    print("largest difference from numpy, in units of a sample:")
    for bits, alpha, space in itertools.product((8, 16), (False, True), ("srgb", "linear")):
        for colour in ([0.2, 0.3, 0.5], [1.5, -0.25, -0.25]):
            files, p, shape = [], [], random.dirichlet([1, 1, 1])
            for k in range(3):
                waves = [numpy.sin(grid[k % 2] / (3 + c + k)) for c in range(3)]
                image = 0.5 + 0.3 * numpy.stack(waves, 2) + random.normal(0, 0.05, (120, 160, 3))
                if alpha:
                    away = numpy.hypot(grid[0] - 60, grid[1] - 80)
                    image = numpy.concatenate([image, (70 - away)[..., None] / 30], 2)
                full = 2**bits - 1
                files.append(written((image.clip(0, 1) * full).round().astype(f"u{bits // 8}")))
                p.append(random.uniform([20, 20], [140, 100], (9, 2)))
            t = sum(a * q for a, q in zip(shape, p))
            box = {"x": 0, "y": 0, "width": 160, "height": 120}
            output = {"compression": "none"}
            warped = []
            for file, own in zip(files, p):
                warp = {"p": own.tolist(), "q": t.tolist(), "output": {**output, "canvas": box}}
                parts = [("image", file), ("warp", json.dumps(warp).encode())]
                warped.append(read(program.form("/warp", parts)))
            images = [
                {"image": k, "p": own.tolist(), "shape": a, "colour": b}
                for k, (own, a, b) in enumerate(zip(p, shape, colour))
            ]
            blend = {"images": images, "align": "none", "space": space, "output": output}
            parts = [("image", file) for file in files] + [("blend", json.dumps(blend).encode())]
            found = with_alpha(read(program.form("/blend", parts)))[..., :4]
            expected = by_numpy(warped, colour, space == "linear")
            off = numpy.abs(found - expected) * (2**bits - 1)
            # Nobody sees a colour without alpha.
            off[..., :3][(expected[..., 3] * (2**bits - 1)).round() == 0] = 0
            kind = "difference" if min(colour) < 0 else "coverage"
            print(f"  {bits:2} bit, alpha {alpha!s:5}, {space:6}, {kind:10}: {off.max():.3f}")
            assert off.max() <= 1


def photographs(count):
    """Files of 1 megapixel with 68 landmarks each."""
    random = numpy.random.default_rng(7)
    photo = Image.open(PHOTO).convert("RGB").resize((WIDTH, HEIGHT))
    mean = random.uniform([200, 150], [950, 720], (68, 2))
    for k in range(count):
        file = io.BytesIO()
        turned = photo.rotate(k % 7 - 3, resample=Image.Resampling.BILINEAR)
        turned.save(file, "PNG", compress_level=1)
        yield file.getvalue(), (mean + random.normal(0, 12, (68, 2))).tolist()


def timed(act):
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


def compare(program, faces, what):
    ids = []
    for file, p in faces:
        parts = [("image", file), ("warp", json.dumps({"p": p}).encode())]
        ids.append(json.loads(program.form("/sessions", parts))["id"])
    target = numpy.mean([p for _, p in faces], 0).tolist()

    def warps():
        for id in ids:
            program.post(f"/sessions/{id}/warp", {"q": target})

    def blend():
        program.post("/blend", {"images": [{"session": id} for id in ids]})

    blend(), warps()
    times, decodes = {warps: [], blend: []}, {}
    for _ in range(ROUNDS):
        for act in times:
            before = program.decoded()
            times[act].append(timed(act))
            decodes[act] = program.decoded() - before
    warped, blended = (statistics.median(times[act]) for act in (warps, blend))
    print(
        f"{what}: {len(ids)} warps {warped:.2f} s ({decodes[warps]} decoded), one blend "
        f"{blended:.2f} s ({decodes[blend]} decoded), ratio {blended / warped:.2f}"
    )


def memory(program, faces):
    for count in sorted({2, 10, len(faces)}):
        parts = [("image", file) for file, _ in faces[:count]]
        images = [{"image": k, "p": p} for k, (_, p) in enumerate(faces[:count])]
        parts.append(("blend", json.dumps({"images": images}).encode()))
        pathlib.Path(f"/proc/{program.process.pid}/clear_refs").write_text("5")
        program.form("/blend", parts)
        files = sum(len(part) for _, part in parts) / 2**20
        peak = program.memory("VmHWM")
        print(f"{count:3} images: most resident memory {peak:.0f} MiB, their files {files:.0f} MiB")


def main():
    path = sys.argv[1]
    faces = list(photographs(int(sys.argv[2]) if len(sys.argv) > 2 else 50))
    with Program(path) as program:
        agreement(program)
    large = ("--memory-bytes", "3GiB", "--store-bytes", "1GiB", "--max-body-bytes", "512MiB")
    with Program(path, *large, "--image-cache-bytes", "2GiB") as program:
        compare(program, faces, "decoded before")
    with Program(path, *large, "--image-cache-bytes", "1MiB") as program:
        compare(program, faces, "decoded each time")
    with Program(path, *large, "--image-cache-bytes", "1MiB") as program:
        memory(program, faces)


if __name__ == "__main__":
    main()
