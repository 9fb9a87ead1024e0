"""Warps a photograph with keypoints, boxes and a label mask by albumentations and by the program,
and measures how well the annotations follow the picture, and how many pictures per second each
makes. Run it by tests/bench/annotations."""

import http.client
import json
import os
import pathlib
import re
import statistics
import subprocess
import time
import uuid
import warnings

import albumentations
import cv2
import numpy

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("MLSWARP_PROGRAM", ROOT / "target" / "release" / "mlswarp")
FILES = ROOT / "target" / "annotations-files"
RESULTS = ROOT / "tests" / "bench" / "results" / "annotations.md"
PHOTO = ROOT / "tests" / "images" / "astronaut.png"
# Pictures of one contender for accuracy: at most, at least, and how many of them are compared with
# the inverse.
PICTURES, FEWEST, INVERSES = 20, 3, 3
# Seconds of one contender, for accuracy and for speed, and its samples for speed: at least and at
# most.
PATIENCE, ENOUGH, LEAST, MOST = 40.0, 5.0, 2, 200
# Frames of a batch.
BATCH = 50
# Six keypoints in each direction, and three boxes.
KEYPOINTS = numpy.array([[x, y] for y in range(46, 512, 84) for x in range(46, 512, 84)])
BOXES = numpy.array([[x, y, x + 100, y + 80] for y in (40, 210, 380) for x in (40, 200, 360)])
LABELS = numpy.array([0, 37, 91, 180, 255], numpy.uint8)
DOT = [
    [0, 60, 120, 60, 0],
    [60, 180, 255, 180, 60],
    [120, 255, 255, 255, 120],
    [60, 180, 255, 180, 60],
    [0, 60, 120, 60, 0],
]
JSON = {"Content-Type": "application/json"}

cv2.setNumThreads(1)
warnings.simplefilter("ignore")
lines = []

HEAD = """\
Both sides warp one photograph of 512 x 512 pixels with 36 keypoints, 9 boxes and a label mask, with
random displacements of about the same size where the other side has a parameter for it. Positions
are in px.

- **Keypoints.** A dot of 5 x 5 pixels is drawn at each one, in a channel of its own, and warped
  with the picture. The drift is the distance between the centroid of the warped dot and the
  keypoint that is returned. The keypoints lie on pixel centres, because albumentations rounds them.
  A keypoint is lost if its dot is in the picture and it is not returned.
- **Boxes.** Each is drawn filled, in a channel of its own, and warped. The error is the largest
  difference of a side of the box that is returned from the bounding box of the pixels that are at
  least half covered, which is itself rounded to whole pixels.
- **Labels.** Of the pixels of the warped mask: those whose label the source does not have, and
  those that differ from the source's label at the exact inverse of the pixel's centre, which is the
  map that albumentations draws with, and `POST /points` with `"inverse": true` for mlswarp. A pixel
  is at a border if the source has another label within 0.5 px of that position.
- **Speed.** Samples of all contenders alternate; medians; one compute thread each. albumentations
  runs in the measuring process and returns arrays, or PNG files of the picture and the mask
  (compression 1). mlswarp runs in a process of its own and always returns PNG files over HTTP, as
  three requests for each picture (picture, mask, positions) or as one batch; `arrays` includes
  their decoding by OpenCV.

`mask` and `direct` are the two ways in which albumentations maps keypoints; `mask` is its default.
"""


def say(line=""):
    print(line, flush=True)
    lines.append(line)


def png(picture):
    return cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def decoded(file):
    return cv2.imdecode(numpy.frombuffer(file, numpy.uint8), cv2.IMREAD_UNCHANGED)


def sheets(channels):
    """Pictures of three channels each."""
    return [numpy.stack(channels[i : i + 3], axis=2) for i in range(0, len(channels), 3)]


def dot(shape, x, y):
    canvas = numpy.zeros(shape, numpy.uint8)
    canvas[y - 2 : y + 3, x - 2 : x + 3] = DOT
    return canvas


def filled(shape, left, top, right, bottom):
    canvas = numpy.zeros(shape, numpy.uint8)
    canvas[top:bottom, left:right] = 255
    return canvas


class Job:
    """The photograph, its annotations, and the sheets on which they are drawn."""

    def __init__(self):
        self.photo = cv2.imread(str(PHOTO))
        self.shape = self.photo.shape[:2]
        grey = cv2.GaussianBlur(cv2.cvtColor(self.photo, cv2.COLOR_BGR2GRAY), (0, 0), 4)
        self.mask = LABELS[numpy.digitize(grey, [40, 90, 140, 190])]
        self.dots = sheets([dot(self.shape, x, y) for x, y in KEYPOINTS])
        self.boxes = sheets([filled(self.shape, *box) for box in BOXES])


class Warped:
    """A picture and its annotations after a warp. A keypoint or box that was not returned is
    missing from its dictionary."""

    def __init__(self, photo, mask, keypoints, boxes, dots=(), drawn=()):
        self.photo, self.mask, self.keypoints, self.boxes = photo, mask, keypoints, boxes
        self.dots = [sheet[..., c] for sheet in dots for c in range(3)]
        self.drawn = [sheet[..., c] for sheet in drawn for c in range(3)]


class Theirs:
    """A transform of albumentations. `places()`: the source position of each pixel of the last
    picture."""

    def __init__(self, job, make, method):
        self.job, self.transform = job, make(method)
        self.boxes = albumentations.BboxParams(format="pascal_voc", label_fields=["box_ids"])
        self.keypoints = albumentations.KeypointParams(format="xy", label_fields=["keypoint_ids"])
        draw = self.transform.get_params_dependent_on_data

        def recorded(**arguments):
            self.maps = draw(**arguments)
            return self.maps

        self.transform.get_params_dependent_on_data = recorded
        self.composed = self.compose({})
        self.with_sheets = self.compose({name: "image" for name in self.sheets()})

    def compose(self, targets):
        return albumentations.Compose(
            [self.transform], self.boxes, self.keypoints, targets, seed=11
        )

    def sheets(self):
        return {f"dots{i}": s for i, s in enumerate(self.job.dots)} | {
            f"boxes{i}": s for i, s in enumerate(self.job.boxes)
        }

    def annotated(self):
        ids = {"box_ids": list(range(len(BOXES))), "keypoint_ids": list(range(len(KEYPOINTS)))}
        return {
            "image": self.job.photo,
            "mask": self.job.mask,
            "bboxes": BOXES,
            "keypoints": KEYPOINTS,
        } | ids

    def warp(self):
        done = self.with_sheets(**self.annotated(), **self.sheets())
        keypoints, boxes = (
            {int(i): numpy.array(v) for i, v in zip(done[ids], done[values])}
            for ids, values in (("keypoint_ids", "keypoints"), ("box_ids", "bboxes"))
        )
        drawn = [
            [done[name] for name in self.sheets() if name.startswith(kind)]
            for kind in ("dots", "boxes")
        ]
        return Warped(done["image"], done["mask"], keypoints, boxes, *drawn)

    def places(self):
        return numpy.stack([self.maps["map_x"], self.maps["map_y"]], axis=2)

    def arrays(self):
        self.composed(**self.annotated())
        return 1

    def files(self):
        done = self.composed(**self.annotated())
        png(done["image"])
        png(done["mask"])
        return 1

    def contenders(self):
        return {"PNG files": self.files, "arrays": self.arrays}


class Program:
    """The running program and one connection to it."""

    def __init__(self):
        # One compute thread; the connection and the sessions outlive the turns of the other side.
        options = {
            "listen": "127.0.0.1:0",
            "workers": "1",
            "max-warp-json-bytes": "32MiB",
            "header-timeout": "1h",
            "session-idle": "1h",
        }
        command = [
            PROGRAM,
            "serve",
            *(word for name, value in options.items() for word in (f"--{name}", value)),
        ]
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith("MLSWARP_")
        }
        FILES.mkdir(parents=True, exist_ok=True)
        log = FILES / "program.log"
        with open(log, "w") as file:
            self.process = subprocess.Popen(
                command, env=environment, stdout=file, stderr=subprocess.STDOUT
            )
        while not (address := re.search(r"http://([0-9.]+:[0-9]+)", log.read_text())):
            if self.process.poll() is not None:
                raise SystemExit(f"the program did not start: {log.read_text()}")
            time.sleep(0.02)
        self.connection = http.client.HTTPConnection(address[1])

    def ask(self, method, path, body=None, headers=JSON):
        self.connection.request(
            method, path, body if isinstance(body, bytes | None) else json.dumps(body), headers
        )
        response = self.connection.getresponse()
        data = response.read()
        if response.status >= 300:
            raise RuntimeError(f"{method} {path}: {response.status} {data[:300]}")
        return data

    def session(self, picture, warp):
        boundary = uuid.uuid4().hex
        parts = [("image", png(picture)), ("warp", json.dumps(warp).encode())]
        head = '--{}\r\nContent-Disposition: form-data; name="{}"; filename="a"\r\n\r\n'
        body = (
            b"".join(head.format(boundary, name).encode() + data + b"\r\n" for name, data in parts)
            + f"--{boundary}--\r\n".encode()
        )
        made = self.ask(
            "POST", "/sessions", body, {"Content-Type": f"multipart/form-data; boundary={boundary}"}
        )
        return "/sessions/" + json.loads(made)["id"]


class Ours:
    """A method of the program on a lattice of handles that move at random."""

    def __init__(self, job, program, method, handles, sigma):
        self.job, self.program, self.sigma, self.random = (
            job,
            program,
            sigma,
            numpy.random.default_rng(11),
        )
        height, width = job.shape
        x, y = numpy.linspace(0, width, handles), numpy.linspace(0, height, handles)
        self.p = numpy.stack(numpy.meshgrid(x, y), axis=2).reshape(-1, 2)
        warp = {"p": self.p.tolist(), "method": method}
        self.session = program.session(job.photo, warp)
        self.dots, self.boxes = (
            [f"{kind}{i}" for i in range(len(drawn))]
            for kind, drawn in (("dots", job.dots), ("boxes", job.boxes))
        )
        for name, picture in zip(self.dots + self.boxes, job.dots + job.boxes):
            self.put(name, picture, "image")
        self.put("mask", job.mask, "labels")

    def put(self, name, picture, kind):
        self.program.ask(
            "PUT",
            f"{self.session}/layers/{name}?kind={kind}",
            png(picture),
            {"Content-Type": "image/png"},
        )

    def pose(self):
        return (self.p + self.random.normal(0, self.sigma, self.p.shape)).tolist()

    def picture(self, **layer):
        return self.program.ask("POST", f"{self.session}/warp", {"q": self.q} | layer)

    def map(self, **annotations):
        return json.loads(
            self.program.ask("POST", f"{self.session}/points", {"q": self.q} | annotations)
        )

    def made(self):
        self.q = self.pose()
        annotations = self.map(**self.annotations())
        return (
            self.picture(),
            self.picture(layer="mask"),
            annotations["points"],
            annotations["boxes"],
        )

    def annotations(self):
        return {"points": (KEYPOINTS + 0.5).tolist(), "boxes": BOXES.tolist()}

    def files(self):
        self.made()
        return 1

    def arrays(self):
        photo, mask, *_ = self.made()
        decoded(photo)
        decoded(mask)
        return 1

    def batch(self):
        body = {
            "frames": [{"q": self.pose()} for _ in range(BATCH)],
            "layers": ["mask"],
        } | self.annotations()
        self.program.ask("POST", f"{self.session}/batch", body)
        return BATCH

    def contenders(self):
        return {
            "PNG files": self.files,
            "arrays": self.arrays,
            f"PNG files, batches of {BATCH}": self.batch,
        }

    def warp(self):
        photo, mask, points, boxes = self.made()
        photo, mask = decoded(photo), decoded(mask)
        # What is outside is dropped, and boxes are clipped, as the other side does it.
        height, width = self.job.shape
        keypoints = {
            i: numpy.array(v) - 0.5
            for i, v in enumerate(points)
            if 0 <= v[0] < width and 0 <= v[1] < height
        }
        boxes = {i: numpy.clip(v, 0, [width, height, width, height]) for i, v in enumerate(boxes)}
        dots, drawn = (
            [decoded(self.picture(layer=name))[..., :3] for name in group]
            for group in (self.dots, self.boxes)
        )
        return Warped(photo[..., :3], mask, keypoints, boxes, dots, drawn)

    def places(self):
        y, x = numpy.indices(self.job.shape)
        centres = numpy.stack([x, y], axis=2).reshape(-1, 2) + 0.5
        found = self.map(points=centres.tolist(), inverse=True)["points"]
        found = numpy.array([[numpy.nan, numpy.nan] if place is None else place for place in found])
        return found.reshape(*self.job.shape, 2) - 0.5


def centroid(channel):
    weights = numpy.where(channel >= 64, channel, 0).astype(float)
    y, x = numpy.indices(channel.shape)
    return numpy.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()


def bounding(channel):
    y, x = numpy.nonzero(channel >= 128)
    return numpy.array([x.min(), y.min(), x.max() + 1, y.max() + 1])


def touches_border(channel, least):
    return (
        max(side.max() for side in (channel[:3], channel[-3:], channel[:, :3], channel[:, -3:]))
        >= least
    )


def labels_at(mask, places, shift=(0, 0)):
    """The labels of the pixels nearest to places; 0 outside."""
    height, width = mask.shape
    places = numpy.rint(numpy.nan_to_num(places + numpy.array(shift), nan=-2)).astype(int)
    x, y = places[..., 0], places[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return numpy.where(inside, mask[y.clip(0, height - 1), x.clip(0, width - 1)], 0)


class Figures:
    """What is measured over all pictures of one contender."""

    def __init__(self):
        self.drift, self.sides, self.displacements = [], [], []
        self.pictures = self.lost = self.invented = self.pixels = self.wrong = self.wrong_inside = (
            self.dots
        ) = 0

    def add(self, job, warped):
        for i, channel in enumerate(warped.dots):
            # A dot at the border may be cut off.
            if channel.max() < 128 or touches_border(channel, 32):
                continue
            self.dots += 1
            if i not in warped.keypoints:
                self.lost += 1
                continue
            centre = centroid(channel)
            self.drift.append(numpy.hypot(*(warped.keypoints[i] - centre)))
            self.displacements.append(((centre - KEYPOINTS[i]) ** 2).sum())
        for i, channel in enumerate(warped.drawn):
            if channel.max() >= 128 and i in warped.boxes:
                self.sides.append(numpy.abs(warped.boxes[i] - bounding(channel)).max())
        self.invented += (~numpy.isin(warped.mask, numpy.unique(numpy.append(job.mask, 0)))).sum()

    def add_labels(self, job, mask, places):
        expected = labels_at(job.mask, places)
        wrong = mask != expected
        around = [
            labels_at(job.mask, places, (dx, dy)) for dx in (-0.5, 0, 0.5) for dy in (-0.5, 0, 0.5)
        ]
        self.pixels += mask.size
        self.wrong += wrong.sum()
        self.wrong_inside += (
            wrong & numpy.all([labels == expected for labels in around], axis=0)
        ).sum()


def measure(job, contenders):
    """The figures of contenders: {name: object}; those of albumentations after the first have the
    same maps."""
    figures = {}
    for name, contender in contenders.items():
        figures[name], began = Figures(), time.perf_counter()
        for i in range(PICTURES):
            if i >= FEWEST and time.perf_counter() - began > PATIENCE:
                break
            figures[name].pictures += 1
            warped = contender.warp()
            figures[name].add(job, warped)
            if i < INVERSES:
                figures[name].add_labels(job, warped.mask, contender.places())
            if i == 0:
                show(name, job, warped)
    return figures


def show(name, job, warped):
    """Writes the picture with what was returned, the mask, and the dots in red, green and blue."""
    marked = warped.photo.copy()
    for x, y in warped.keypoints.values():
        cv2.circle(marked, (round(x), round(y)), 3, (0, 255, 255), 1)
    for box in warped.boxes.values():
        left, top, right, bottom = (round(float(v)) for v in box[:4])
        cv2.rectangle(marked, (left, top), (right - 1, bottom - 1), (0, 255, 0), 1)
    dots = numpy.zeros_like(job.photo)
    for i, channel in enumerate(warped.dots):
        dots[..., i % 3] = numpy.maximum(dots[..., i % 3], channel)
    mask = cv2.cvtColor(warped.mask, cv2.COLOR_GRAY2BGR)
    cv2.imwrite(
        str(FILES / (re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") + ".png")),
        numpy.hstack([marked, mask, dots]),
    )


def turns(contenders):
    """Pictures per second of {name: function, which makes that many}; one sample of each in turn,
    after one that is not measured. Slow ones stop when their time is used."""
    samples, spent = {name: [] for name in contenders}, dict.fromkeys(contenders, 0.0)
    for turn in range(MOST + 1):
        for name, work in contenders.items():
            if turn <= LEAST or spent[name] < ENOUGH:
                began = time.perf_counter()
                pictures = work()
                seconds = time.perf_counter() - began
                spent[name] += seconds
                if turn > 0:
                    samples[name].append(seconds / pictures)
    return {name: 1 / statistics.median(s) for name, s in samples.items()}


COLUMNS = [
    "pictures",
    "displacement, px RMS",
    "keypoint drift, px: median",
    "p99",
    "max",
    "keypoints lost",
    "box sides, px: median",
    "max",
    "invented labels",
    "labels unlike the inverse, % of pixels",
    "pixels of these not at a border",
]


def row(name, figures):
    drift, sides = numpy.array(figures.drift), numpy.array(figures.sides)
    at = f"{numpy.median(drift):.2f} | {numpy.percentile(drift, 99):.2f} | {drift.max():.2f}"
    box = f"{numpy.median(sides):.2f} | {sides.max():.2f}"
    displaced = numpy.sqrt(numpy.mean(figures.displacements))
    share = f"{100 * figures.wrong / figures.pixels:.3f} | {figures.wrong_inside}"
    say(
        f"| {name} | {figures.pictures} | {displaced:.1f} | {at} | {figures.lost} of "
        f"{figures.dots} | {box} | {figures.invented} | {share} |"
    )


def kinds():
    """{kind: (a function that makes their transform, its description, our method, handles along a
    side, sigma of their moves in px)}."""
    return {
        "elastic": (
            lambda method: albumentations.ElasticTransform(
                alpha=1600, sigma=24, keypoint_remapping_method=method, p=1
            ),
            "`ElasticTransform(alpha=1600, sigma=24)`",
            "rigid",
            9,
            8.0,
        ),
        "piecewise affine": (
            lambda method: albumentations.PiecewiseAffine(keypoint_remapping_method=method, p=1),
            "`PiecewiseAffine()`",
            "affine",
            4,
            0.04 * 512 / 3,
        ),
        "thin plate": (
            lambda method: albumentations.ThinPlateSpline(
                scale_range=(0.02, 0.02), keypoint_remapping_method=method, p=1
            ),
            "`ThinPlateSpline(scale_range=(0.02, 0.02))`",
            "tps",
            4,
            0.04 * 512 / 3,
        ),
    }


def main():
    job = Job()
    cpu = [line.split(": ")[1] for line in open("/proc/cpuinfo") if line.startswith("model name")]
    versions = (
        f"albumentations {albumentations.__version__}, cv2 {cv2.__version__}, numpy "
        f"{numpy.__version__}"
    )
    say(
        "# annotations: a picture, its keypoints, boxes and label mask, side by side with "
        "albumentations\n"
    )
    say(HEAD)
    say(
        f"Machine: {cpu[0].strip()}, {os.cpu_count()} threads, load {os.getloadavg()[0]:.2f} "
        f"before; {versions}.\n"
    )
    program = Program()
    try:
        for kind, (make, description, method, handles, sigma) in kinds().items():
            mine = f"mlswarp, `{method}`, {handles} x {handles} handles"
            contenders = {mine: Ours(job, program, method, handles, sigma)}
            contenders |= {
                f"{description}, keypoints by `{way}`": Theirs(job, make, way)
                for way in ("mask", "direct")
            }
            say(f"## {kind}: accuracy\n")
            say("| what | " + " | ".join(COLUMNS) + " |\n|---|" + "---:|" * len(COLUMNS))
            for name, figures in measure(job, contenders).items():
                row(name, figures)
            say(f"\n## {kind}: pictures per second with annotations, one thread each\n")
            say("| what | pictures per second |\n|---|---:|")
            speed = {}
            for name, contender in contenders.items():
                speed |= {f"{name}: {what}": work for what, work in contender.contenders().items()}
            for name, rate in turns(speed).items():
                say(f"| {name} | {rate:.2f} |")
            say()
    finally:
        program.process.terminate()
        program.process.wait()
    RESULTS.write_text("\n".join(lines) + "\n")


main()
