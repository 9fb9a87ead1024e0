"""Times Python's image libraries in turn with the benches `render`, `png`, `jpeg` and `request` in
their paired mode (harness/paired.rs): each sample is one warm call, ours and theirs alternate, and
medians of one run are compared. One thread everywhere, unless a row says otherwise."""

import io
import json
import os
import pathlib
import statistics
import subprocess
import time

os.environ["VIPS_CONCURRENCY"] = "1"

import cv2
import numpy
import PIL
import pyvips
import skimage
from PIL import Image
from skimage.transform import warp

ROOT = pathlib.Path(__file__).resolve().parents[2]
FILES = ROOT / "target" / "peers-files"
RESULTS = ROOT / "tests" / "bench" / "results" / "peers.md"
# Maximum seconds and minimum samples of one contender in one table.
ENOUGH, LEAST = 2.0, 3

cv2.setNumThreads(1)
lines = []


def say(line=""):
    print(line, flush=True)
    lines.append(line)


def build():
    """Builds the benches; returns the paths of their programs."""
    command = [
        "cargo",
        "bench",
        "--no-run",
        "--quiet",
        "--message-format=json",
        "--bench",
        "render",
        "--bench",
        "png",
        "--bench",
        "jpeg",
        "--bench",
        "request",
    ]
    told = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, check=True, text=True).stdout
    messages = [json.loads(line) for line in told.splitlines() if line.startswith("{")]
    return {
        m["target"]["name"]: m["executable"]
        for m in messages
        if m.get("executable") and "bench" in m["target"]["kind"]
    }


class Ours:
    """A bench in paired mode: it has written its files and answers with seconds."""

    def __init__(self, program, name):
        self.folder = FILES / name
        self.process = subprocess.Popen(
            [program, "--paired", str(self.folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout.readline().strip() == "ready"
        self.index = json.loads((self.folder / "index.json").read_text())

    def seconds(self, case):
        self.process.stdin.write(case + "\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())

    def picture(self, file, case):
        return numpy.fromfile(self.folder / file, numpy.uint8).reshape(
            case["height"], case["width"], 4
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait()


def here(work):
    """Seconds of a warm call in this process."""

    def seconds():
        work()
        begin = time.perf_counter()
        work()
        return time.perf_counter() - begin

    return seconds


def low(samples):
    """The fastest 5 %: the time without disturbance."""
    return sorted(samples)[len(samples) // 20]


def turns(contenders, rounds=101):
    """`contenders`: {name: function that gives seconds}; one sample of each in turn. Slow ones stop
    when their time is used."""
    samples = {name: [] for name in contenders}
    spent = dict.fromkeys(contenders, 0.0)
    for turn in range(rounds):
        for name, seconds in contenders.items():
            if turn < LEAST or spent[name] < ENOUGH:
                begin = time.perf_counter()
                samples[name].append(seconds())
                spent[name] += time.perf_counter() - begin
    return samples


def table(title, contenders, sizes=None):
    """Prints medians and their ratio to the first contender; returns (median, fastest 5 %) of
    each."""
    times = {name: (statistics.median(s), low(s)) for name, s in turns(contenders).items()}
    first, first_low = next(iter(times.values()))
    say(f"## {title}\n")
    say(
        "| what | median, ms | ratio to the first | fastest 5 %, ms | its ratio |"
        + (" bytes |" if sizes else "")
    )
    say("|---|---:|---:|---:|---:|" + ("---:|" if sizes else ""))
    for name, (median, least) in times.items():
        row = (
            f"| {name} | {median * 1e3:.3f} | {median / first:.2f} | {least * 1e3:.3f} | "
            f"{least / first_low:.2f} |"
        )
        say(row + (f" {sizes[name]} |" if sizes else ""))
    say()
    return times


def render(program, goals):
    """Our mesh to pixels, compared with samplers of the same dense map."""
    limits = {
        "500x500": 0.65,
        "1920x1080": 0.6,
        "3840x2160": 0.6,
        "500x500-folded-1": 1.0,
        "500x500-folded-10": 1.6,
    }
    with Ours(program, "render") as ours:
        for case in ours.index:
            name, source = case["case"], ours.picture(case["source"], case)
            # Their pixel centres have integer coordinates.
            places = numpy.fromfile(ours.folder / case["map"], numpy.float32).reshape(
                case["height"], case["width"], 2
            ) - numpy.float32(0.5)
            x, y = numpy.ascontiguousarray(places[..., 0]), numpy.ascontiguousarray(places[..., 1])
            fixed = cv2.convertMaps(places, None, cv2.CV_16SC2)
            out = numpy.zeros_like(source)

            def remap(a, b):
                return here(
                    lambda: cv2.remap(
                        source,
                        a,
                        b,
                        cv2.INTER_LINEAR,
                        dst=out,
                        borderMode=cv2.BORDER_CONSTANT,
                        borderValue=0,
                    )
                )

            contenders = {
                f"mlswarp ({case['level']})": lambda: ours.seconds(name),
                "cv2.remap, map as two planes of f32": remap(x, y),
                "cv2.remap, map as pairs of f32": remap(places, None),
                "cv2.remap, map prepared as 16-bit fixed point": remap(*fixed),
                "pyvips mapim, bilinear": here(vips_mapim(source, places)),
            }
            if name == "500x500":
                contenders["skimage warp, order 1, a channel after the other, f64"] = here(
                    skimage_warp(source, y, x)
                )
            times = table(f"render {case['what']}", contenders)
            # Compare the results: mlswarp repeats the border inside the map, and renders nothing
            # outside.
            out = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            out[x < -1] = 0
            apart = numpy.abs(ours.picture(case["ours"], case).astype(int) - out).max(axis=2)
            say(
                "Pixels that differ by more than 8 of 255 between cv2 and ours: "
                f"{(apart > 8).sum()} of {apart.size}.\n"
            )
            mine, planes, pairs = list(times.values())[:3]
            figure, least = (mine[k] / min(planes[k], pairs[k]) for k in (0, 1))
            goals.append(
                (
                    f"render {case['what']}: ours / cv2.remap (f32 map, the faster form)",
                    figure,
                    limits[name],
                    least,
                )
            )


def vips_mapim(source, places):
    image, index = pyvips.Image.new_from_array(source), pyvips.Image.new_from_array(places)
    linear = pyvips.Interpolate.new("bilinear")
    return lambda: image.mapim(index, interpolate=linear).write_to_memory()


def skimage_warp(source, y, x):
    places = numpy.array([y, x])
    return lambda: [warp(source[..., c], places, order=1) for c in range(4)]


def png(program):
    with Ours(program, "png") as ours:
        for case in ours.index:
            picture = ours.picture(case["picture"], case)
            bgra, pil, vips = (
                cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA),
                Image.fromarray(picture),
                pyvips.Image.new_from_array(picture),
            )

            def pillow(level):
                out = io.BytesIO()
                pil.save(out, "png", compress_level=level)
                return out.getbuffer()

            writers = {
                "cv2.imencode": lambda: cv2.imencode(".png", bgra)[1],
                "cv2.imencode, level 1": lambda: cv2.imencode(
                    ".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 1]
                )[1],
                "Pillow, level 1": lambda: pillow(1),
                "Pillow, level 6": lambda: pillow(6),
                "pyvips pngsave, compression 1": lambda: vips.pngsave_buffer(compression=1),
                "pyvips pngsave, compression 6": lambda: vips.pngsave_buffer(compression=6),
            }
            mine = f"mlswarp ({case['level']})"
            contenders = {mine: lambda: ours.seconds(case["case"])} | {
                name: here(work) for name, work in writers.items()
            }
            sizes = {mine: case["bytes"]} | {name: len(work()) for name, work in writers.items()}
            table(
                f"PNG of the warped photograph, {case['width']} x {case['height']} RGBA",
                contenders,
                sizes,
            )


def jpeg(program, goals):
    """Our strips one after the other, on every level, and on two threads, compared with
    libjpeg-turbo and others; then bytes and PSNR."""
    limits = {"avx2": 0.55, "avx512": 0.45, "2 threads": 0.35}
    with Ours(program, "jpeg") as ours:
        for case in (case for case in ours.index if case["width"] >= 500):
            rgb = numpy.fromfile(ours.folder / case["picture"], numpy.uint8).reshape(
                case["height"], case["width"], 3
            )
            bgr, pil, vips = (
                numpy.ascontiguousarray(rgb[..., ::-1]),
                Image.fromarray(rgb),
                pyvips.Image.new_from_array(rgb),
            )

            def pillow():
                out = io.BytesIO()
                pil.save(out, "jpeg", quality=85, subsampling=2)
                return out.getbuffer()

            name = case["case"]
            contenders = {"cv2.imencode (libjpeg-turbo)": here(lambda: turbo(bgr, 85, "420"))}
            mine = [*case["levels"], "2 threads"]
            contenders |= {
                f"mlswarp, {way}": lambda way=way: ours.seconds(f"{name} {way}") for way in mine
            }
            contenders |= {
                "Pillow": here(pillow),
                "pyvips jpegsave": here(lambda: vips.jpegsave_buffer(Q=85)),
            }
            times = table(
                f"JPEG 4:2:0 of the photograph at quality 85, {case['width']} x {case['height']} "
                "RGB",
                contenders,
            )
            theirs = times["cv2.imencode (libjpeg-turbo)"]
            for way in mine:
                if way in limits:
                    figure, least = (times[f"mlswarp, {way}"][k] / theirs[k] for k in (0, 1))
                    goals.append((f"JPEG {name}, {way}: ours / cv2", figure, limits[way], least))
        say("## JPEG, ours compared with libjpeg-turbo as one decoder reads them\n")
        say(
            "| picture | quality | 4:2:0: bytes | PSNR, dB | difference | 4:4:4: bytes | PSNR, dB "
            "| difference |\n|---|---:|---:|---:|---:|---:|---:|---:|"
        )
        worst = 0.0
        for case in ours.index:
            bgr = numpy.fromfile(ours.folder / case["picture"], numpy.uint8).reshape(
                case["height"], case["width"], 3
            )
            bgr = numpy.ascontiguousarray(bgr[..., ::-1])
            for quality in case["qualities"]:
                cells = []
                for sampling in ("420", "444"):
                    files = (
                        (ours.folder / f"{case['case']}.{quality}.{sampling}.jpg").read_bytes(),
                        turbo(bgr, quality, sampling),
                    )
                    first, second = (
                        ratio(
                            bgr, cv2.imdecode(numpy.frombuffer(file, numpy.uint8), cv2.IMREAD_COLOR)
                        )
                        for file in files
                    )
                    cells += [
                        f"{len(files[0])} ({len(files[0]) / len(files[1]):.3f})",
                        f"{first:.2f}",
                        f"{first - second:+.2f}",
                    ]
                    worst = max(worst, second - first if quality >= 97 else 0)
                say(f"| {case['case']} | {quality} | {' | '.join(cells)} |")
        say()
        goals.append(
            ("JPEG, quality 97 to 100: PSNR below that of libjpeg-turbo, dB", worst, 0.1, worst)
        )


def turbo(bgr, quality, sampling):
    factor = {
        "420": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
        "444": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    }[sampling]
    return cv2.imencode(
        ".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
    )[1]


def ratio(picture, decoded):
    """PSNR, dB."""
    return 10 * numpy.log10(255**2 / numpy.mean((picture.astype(float) - decoded) ** 2))


def rigid(p, q, v):
    """Rigid moving least squares, alpha 1: where the places `v` go when the points `p` go to `q`.
    Shapes: [n, 2], [n, 2], [m, 2]."""
    w = 1.0 / (((p[None] - v[:, None]) ** 2).sum(axis=2) + 1e-9)
    total = w.sum(axis=1, keepdims=True)
    p_star, q_star = w @ p / total, w @ q / total
    a, b = p[None] - p_star[:, None], q[None] - q_star[:, None]
    cos = (w * (a * b).sum(axis=2)).sum(axis=1)
    sin = (w * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])).sum(axis=1)
    norm = numpy.hypot(cos, sin)
    cos, sin = cos / norm, sin / norm
    d = v - p_star
    return (
        numpy.stack([cos * d[:, 0] - sin * d[:, 1], sin * d[:, 0] + cos * d[:, 1]], axis=1) + q_star
    )


def request(program):
    """q to PNG, and the mesh alone, as typical in Python: the inverse map on a coarse grid,
    enlarged and sampled."""
    with Ours(program, "request") as ours:
        case = ours.index
        source = cv2.cvtColor(ours.picture(case["source"], case), cv2.COLOR_RGBA2BGRA)
        width, height, vertices = case["width"], case["height"], case["vertices"]
        p, q = numpy.array(case["p"]), numpy.array(case["q"])
        grid = numpy.stack(
            numpy.meshgrid(numpy.linspace(0, width, vertices), numpy.linspace(0, height, vertices)),
            axis=2,
        ).reshape(-1, 2)
        # cv2.resize puts the samples of the coarse map at the centres of equal blocks.
        steps = [(numpy.arange(vertices) + 0.5) * side / vertices for side in (width, height)]
        centres = numpy.stack(numpy.meshgrid(*steps), axis=2).reshape(-1, 2)

        def chain():
            shown = rigid(q, p, centres) - 0.5
            places = cv2.resize(
                shown.reshape(vertices, vertices, 2).astype(numpy.float32), (width, height)
            )
            return cv2.imencode(
                ".png",
                cv2.remap(source, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT),
            )

        contenders = {
            f"mlswarp ({case['level']}), 1 thread": lambda: ours.seconds("1 thread"),
            "mlswarp, 2 threads": lambda: ours.seconds("2 threads"),
            "numpy (mesh) + cv2.resize + cv2.remap + cv2.imencode": here(chain),
        }
        table(f"q to PNG, {width} x {height}, {len(p)} handles, rigid", contenders)
        contenders = {
            "mlswarp, 1 thread": lambda: ours.seconds("deform"),
            "numpy, f64, no plan": here(lambda: rigid(p, q, grid)),
        }
        table(f"deform 100 x 100 vertices, {len(p)} handles, rigid", contenders)


def main():
    programs = build()
    versions = (
        f"cv2 {cv2.__version__}, Pillow {PIL.__version__}, libvips "
        f"{pyvips.version(0)}.{pyvips.version(1)}.{pyvips.version(2)}"
    )
    cpu = [line.split(": ")[1] for line in open("/proc/cpuinfo") if line.startswith("model name")]
    say("# peers: Python's libraries, in turn with ours\n")
    say(
        f"Machine: {cpu[0].strip()}, {os.cpu_count()} threads, load {os.getloadavg()[0]:.2f} "
        f"before; {versions}, skimage {skimage.__version__}, numpy {numpy.__version__}.\n"
    )
    goals = []
    render(programs["render"], goals)
    png(programs["png"])
    jpeg(programs["jpeg"], goals)
    request(programs["request"])
    say("## Goals\n\n| what | figure | goal | met | of the fastest 5 % |\n|---|---:|---|---|---:|")
    for what, figure, limit, least in goals:
        say(
            f"| {what} | {figure:.3f} | at most {limit:.3f} | {'yes' if figure <= limit else 'no'} "
            f"| {least:.3f} |"
        )
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text("\n".join(lines) + "\n")


main()
