"""The same bytes, numbers and errors as the service."""

import io
import json
import pickle
import zipfile

import mlswarp
import numpy as np
import pytest
from PIL import Image

from conftest import CAT_SIZE, ROOT, P, Q

EXAMPLES = {
    "stretched-cat": "chelsea.png",
    "leaning-rocket": "rocket.jpg",
    "giraffe": "horse-cutout.png",
    "thinner-face": "astronaut.png",
    "fold": "coffee.png",
}
GOLDENS = sorted(path.stem.rsplit("-", 1) for path in (ROOT / "tests/golden").glob("*.png"))


def test_the_goldens_are_known():
    assert {name for name, _ in GOLDENS} == set(EXAMPLES)


@pytest.mark.parametrize(("name", "method"), GOLDENS)
def test_a_file_has_the_bytes_of_the_service(server, name, method):
    image = (ROOT / "tests/images" / EXAMPLES[name]).read_bytes()
    warp = json.loads((ROOT / f"api/examples/{name}.json").read_text())
    if method == "tps":
        warp.pop("alpha", None)
    warp = {**warp, "method": method, "output": {**warp.get("output", {}), "width": 256}}
    status, _, body = server.upload("/warp", image=image, warp=warp)
    assert status == 200, body
    assert mlswarp.warp_file(image, warp) == body


@pytest.mark.parametrize(
    "output",
    [
        {"format": "jpeg", "quality": 90},
        {"format": "webp", "canvas": "fit"},
        {"format": "tiff", "outside": "reflect", "filter": "bicubic"},
    ],
)
def test_files_of_other_formats_too(server, cat, output):
    warp = {"p": P, "q": Q, "output": output, "strength": 1.5}
    mask = (ROOT / "tests/images/chelsea.png").read_bytes()
    assert mlswarp.warp_file(cat, warp) == server.upload("/warp", image=cat, warp=warp)[2]
    with_region = server.upload("/warp", image=cat, warp=warp, region=mask)[2]
    assert mlswarp.warp_file(cat, json.dumps(warp), region=mask) == with_region


def test_what_follows_the_outline_of_the_image(server):
    image = (ROOT / "tests/images/horse-cutout.png").read_bytes()
    p, q = [[330, 215], [545, 300], [600, 120]], [[330, 215], [545, 310], [620, 110]]
    for warp in ({"metric": "geodesic"}, {"method": "arap"}):
        warp = {"p": p, "q": q} | warp
        assert mlswarp.warp_file(image, warp) == server.upload("/warp", image=image, warp=warp)[2]


def png(array):
    file = io.BytesIO()
    Image.fromarray(array).save(file, "png")
    return file.getvalue()


@pytest.mark.parametrize("how", [{"metric": "geodesic", "alpha": 1.5}, {"method": "arap"}], ids=str)
def test_a_mask_is_the_region_of_a_session(server, how):
    """Times the alpha of its image: the same positions and the same pixels."""
    horse = Image.open(ROOT / "tests/images/horse-cutout.png").convert("RGBA")
    image = np.asarray(horse.reduce(3))
    mask = np.full(image.shape[:2], 255, np.uint8)
    mask[: image.shape[0] // 3] = 90
    p, q = [[110, 72], [182, 100], [200, 40]], [[110, 72], [182, 104], [207, 36]]
    parts = {"warp": {"p": p, "mask": {"threshold": 0.2}} | how, "region": png(mask)}
    session = json.loads(server.upload("/sessions", image=png(image), **parts)[2])["id"]
    plan = mlswarp.Plan(p, like=image, mask=mask, mask_threshold=0.2, **how)
    pose = pickle.loads(pickle.dumps(plan)).pose(q)
    assert set(pose.warnings) == set(plan.pose(q).warnings)
    points = [[110, 72], [187.5, 93.25], [3, 3], [200, 39]]
    for inverse in (False, True):
        request = {"q": q, "points": points, "inverse": inverse}
        answer = server.send("POST", f"/sessions/{session}/points", request)[2]
        expected = [row or [np.nan] * 2 for row in json.loads(answer)["points"]]
        np.testing.assert_array_equal(pose.points(points, inverse=inverse), expected)
    drawn = server.send("POST", f"/sessions/{session}/warp", {"q": q})[2]
    drawn = np.asarray(Image.open(io.BytesIO(drawn)).convert("RGBA"))
    warped = pose.warp(image, region=mask)
    visible = drawn[:, :, 3] > 0
    assert ((warped == drawn).all(axis=2) | ~visible).all() and (warped[~visible, 3] == 0).all()
    plain = mlswarp.Plan(p, like=image, metric="geodesic").pose(q)
    assert (plain.points(points) != pose.points(points)).any(), "the mask counts"


def test_a_method_that_is_chosen(server, cat):
    warp = {"p": P[:3] + [[10, 10], [440, 20]], "q": Q[:3] + [[10, 12], [440, 20]]}
    warp["method"] = "auto"
    assert mlswarp.warp_file(cat, warp) == server.upload("/warp", image=cat, warp=warp)[2]


def test_jitter_has_the_poses_of_a_batch(server, cat):
    session = json.loads(server.upload("/sessions", image=cat, warp={"p": P})[2])["id"]
    jitter = {"seed": 7, "count": 4, "sigma": 6}
    path = f"/sessions/{session}/batch"
    status, _, body = server.send("POST", path, {"q": Q, "jitter": jitter})
    assert status == 200, body
    archive = zipfile.ZipFile(io.BytesIO(body))
    images = sorted(name for name in archive.namelist() if name.endswith(".png"))
    plan = mlswarp.Plan(P, size=CAT_SIZE)
    poses = list(plan.jitter(q=Q, **jitter))
    assert len(images) == len(poses) == 4
    for name, pose in zip(images, poses, strict=True):
        assert mlswarp.warp_file(cat, {"p": P, "q": pose.q}) == archive.read(name), name


def test_an_array_is_the_pixels_of_the_file(cat):
    image = np.asarray(Image.open(io.BytesIO(cat)).convert("RGB"))
    pose = mlswarp.Plan(P, like=image).pose(Q)
    file = Image.open(io.BytesIO(mlswarp.warp_file(cat, {"p": P, "q": Q})))
    drawn = np.asarray(file.convert("RGBA"))
    covered = drawn[:, :, 3] == 255
    assert (pose.warp(image)[covered] == drawn[:, :, :3][covered]).all()


def test_points_and_outlines_are_those_of_the_service(server):
    pose = mlswarp.Plan(P, size=CAT_SIZE, method="affine", alpha=1.5).pose(Q)
    points = [[10.5, 20.25], [400, 299], [262, 240]]
    boxes = [[10, 10, 60, 40], [200, 100, 330, 250]]
    polygons = [[[10, 10], [200, 20], [100, 200]]]
    for inverse in (False, True):
        request = {
            "p": P,
            "q": Q,
            "method": "affine",
            "alpha": 1.5,
            "extent": CAT_SIZE,
            "points": points,
            "boxes": boxes,
            "polygons": polygons,
            "inverse": inverse,
        }
        answer = json.loads(server.send("POST", "/points", request)[2])
        np.testing.assert_array_equal(pose.points(points, inverse=inverse), answer["points"])
        np.testing.assert_array_equal(pose.boxes(boxes, inverse=inverse), answer["boxes"])
        [mapped] = pose.polygons(polygons, inverse=inverse)
        np.testing.assert_array_equal(mapped, answer["polygons"][0])


def test_a_report_and_a_fit_are_those_of_the_service(server):
    report = mlswarp.Plan(P, size=CAT_SIZE).pose(Q).report()
    request = {"p": P, "q": Q, "extent": CAT_SIZE}
    answer = json.loads(server.send("POST", "/report", request)[2])
    assert list(report.residuals) == answer["residuals"]
    for name in ("folds", "area_factor", "covered", "round_trip", "tolerance"):
        assert getattr(report, name) == answer[name], name
    p, q = [*P[:3], [10, 10], [440, 20]], [*Q[:3], [10, 12], [440, 20]]
    fit = mlswarp.Plan.fit(p, q, CAT_SIZE)
    answer = json.loads(server.send("POST", "/fit", {"p": p, "q": q, "extent": CAT_SIZE})[2])
    assert fit.best is not None and fit.best.method == answer["best"]["method"]
    assert [one.rms for one in fit.candidates] == [one["rms"] for one in answer["candidates"]]


@pytest.mark.parametrize("name", ["cat.pts", "cat-average.csv"])
def test_landmark_files_are_read_alike(server, name):
    file = (ROOT / "api/examples" / name).read_bytes()
    status, _, body = server.upload("/landmarks", landmarks=file)
    assert status == 200, body
    answer = json.loads(body)
    read = mlswarp.load_landmarks(file)
    assert (list(read.p), read.units, read.format) == (
        answer["p"],
        answer["units"],
        answer["format"],
    )


ROW = [[100, 100], [200, 100], [300, 100]]
MISTAKES = [
    {"p": P, "q": Q[:2]},
    {"p": P},
    {"q": Q},
    {"p": P, "q": [*Q[:3], [1, 2]]},
    {"p": P, "q": Q, "alpha": 99},
    {"p": P, "q": Q, "method": "rigit"},
    {"p": P, "q": Q, "metod": "rigid"},
    {"p": [[1, 2], [3]], "q": [[1, 2], [3, 4]]},
    {"p": [[1, 2], [1, 2]], "q": [[1, 2], [30, 40]], "coincident": {"policy": "reject"}},
    {"p": [[[5, 5], [5, 5]]], "q": [[[5, 5], [5, 5]]]},
    {"p": [[9e9, 2]], "q": [[1, 2]]},
    {"p": P, "q": Q, "weights": [1]},
    {"p": P, "q": Q, "strength": 11},
    {"p": P, "q": Q, "grid": {"tolerance": 9}},
    {"p": P, "q": Q, "output": {"outside": "blue"}},
    {"p": P, "q": Q, "output": {"width": 0}},
    {"p": ROW, "q": [ROW[0], [320, 100], ROW[2]], "folds": "reject"},
    {"p": P, "q": Q, "method": "tps"},
]


@pytest.mark.parametrize("warp", MISTAKES, ids=str)
def test_a_mistake_has_the_same_code_here_and_there(server, cat, warp):
    status, _, body = server.upload("/warp", image=cat, warp=warp)
    problem = json.loads(body)
    assert status >= 400, "the service takes it"
    with pytest.raises(mlswarp.MlswarpError) as caught:
        mlswarp.warp_file(cat, warp)
    error = caught.value
    for name in ("code", "detail", "pointer", "handle", "limit_name", "limit", "actual"):
        assert getattr(error, name) == problem.get(name), name
    assert isinstance(error, ValueError)
    # The parts of the package that take no object say the same.
    rest = {name: value for name, value in warp.items() if name not in ("q", "strength", "folds")}
    pose = {name: value for name, value in warp.items() if name in ("strength", "folds")}
    if "output" in warp or "p" not in warp or "q" not in warp:
        return
    with pytest.raises(mlswarp.MlswarpError) as caught:
        mlswarp.Plan(rest.pop("p"), size=CAT_SIZE, **rest).pose(warp["q"], **pose)
    assert caught.value.code == problem["code"]
    assert caught.value.pointer == problem.get("pointer")


@pytest.mark.parametrize("file", [b"", b"nothing", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_a_file_that_is_no_image(server, file):
    problem = json.loads(server.upload("/warp", image=file, warp={"p": [], "q": []})[2])
    with pytest.raises(mlswarp.BadImage) as caught:
        mlswarp.warp_file(file, {"p": [], "q": []})
    assert (caught.value.code, caught.value.detail) == (problem["code"], problem["detail"])


@pytest.mark.parametrize("region", [b"nothing", (ROOT / "tests/images/coffee.png").read_bytes()])
def test_a_region_that_does_not_fit(server, cat, region):
    warp = {"p": P, "q": Q}
    problem = json.loads(server.upload("/warp", image=cat, warp=warp, region=region)[2])
    with pytest.raises(ValueError) as caught:
        mlswarp.warp_file(cat, warp, region=region)
    for name in ("code", "detail", "limit_name", "limit", "actual"):
        assert getattr(caught.value, name) == problem.get(name), name
