"""The libraries that the package works with."""

import pickle
import re
import sys
import types

import albumentations as A
import cv2
import mlswarp
import numpy as np
import pytest
import scipy.ndimage
import skimage.transform
from mlswarp.augment import RandomWarp
from mlswarp.augment.albumentations import MlsWarp
from PIL import Image

from conftest import ROOT

H, W = 120, 160
P = [[40, 30], [120, 30], [80, 90]]
Q = [[40, 30], [120, 30], [90, 96]]


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(3)
    smooth = scipy.ndimage.gaussian_filter(rng.random((H, W, 3)), (4, 4, 0))
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    return (smooth * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def pose():
    return mlswarp.Plan(P, size=(W, H)).pose(Q)


def test_the_map_is_that_of_opencv_and_scipy(picture, pose):
    x, y = np.moveaxis(pose.map(), 2, 0)
    inside = scipy.ndimage.binary_erosion(pose.coverage() == 255, iterations=2)
    ours = pose.warp(picture)[:, :, 0].astype(int)
    remapped = cv2.remap(picture[:, :, 0], x, y, cv2.INTER_LINEAR)
    assert np.abs(remapped - ours)[inside].max() <= 3
    at = np.nan_to_num(np.stack([y, x]), nan=-9)
    mapped = scipy.ndimage.map_coordinates(picture[:, :, 0].astype(float), at, order=1)
    assert np.abs(mapped - ours)[inside].max() <= 3


def test_skimage_warps_by_a_pose(picture, pose):
    warped = skimage.transform.warp(picture, pose.for_skimage(), preserve_range=True)
    inside = scipy.ndimage.binary_erosion(pose.coverage() == 255, iterations=2)
    assert np.abs(warped - pose.warp(picture))[inside].max() <= 3


def test_random_warps_repeat_do_not_fold_and_are_pickled():
    warp = RandomWarp(sigma=6, grid=(5, 4))
    first, second = (one.sample(np.random.default_rng(1), (W, H)) for one in (warp, warp))
    assert first.q == second.q and first.folds == 0
    assert pickle.loads(pickle.dumps(warp)).sample(np.random.default_rng(1), (W, H)).q == first.q
    wild = RandomWarp(sigma=200)
    assert all(wild.sample(np.random.default_rng(k), (W, H)).folds == 0 for k in range(10))
    with pytest.raises(ValueError):
        RandomWarp(sigma=1, grid=(1, 5))


def compose(seed=7, **options):
    return A.Compose(
        [MlsWarp(sigma=6, p=1, **options)],
        keypoint_params=A.KeypointParams(format="xy", remove_invisible=False),
        bbox_params=A.BboxParams(format="pascal_voc", label_fields=["classes"]),
        seed=seed,
    )


def test_albumentations_moves_everything_alike(picture):
    dots = np.zeros((H, W, 3), np.uint8)
    places = [(40, 50), (100, 30), (77, 80)]
    for x, y in places:
        dots[y, x] = 255
    mask = np.zeros((H, W), np.int32)
    mask[30:90, 40:120] = 70_000
    data = {"image": dots, "mask": mask, "keypoints": places, "bboxes": [[40, 30, 120, 90]]}
    result = compose()(**data, classes=["a"])
    again = compose()(**data, classes=["a"])
    assert (result["image"] == again["image"]).all(), "a seed repeats"
    other = compose(seed=8)(**data, classes=["a"])
    assert (result["image"] != other["image"]).any()
    assert len(result["keypoints"]) == len(places)
    for x, y in result["keypoints"]:
        left, top = int(x) - 3, int(y) - 3
        near = result["image"][top : top + 8, left : left + 8, 0].astype(float)
        rows, columns = np.mgrid[top : top + 8, left : left + 8]
        seen = np.array([(columns * near).sum(), (rows * near).sum()]) / near.sum()
        assert np.abs(seen - (x, y)).max() < 0.25
    assert set(np.unique(result["mask"])) == {0, 70_000}
    rows, columns = np.nonzero(result["mask"])
    edges = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert np.abs(np.array(result["bboxes"][0]) - edges).max() <= 1.01


def test_albumentations_takes_other_arrays(picture):
    channels = np.random.default_rng(0).random((H, W, 6), dtype=np.float32)
    mask = np.zeros((H, W, 2), np.uint8)
    result = A.Compose([MlsWarp(p=1)], seed=1)(image=channels, mask=mask)
    assert (result["image"].shape, result["image"].dtype) == (channels.shape, channels.dtype)
    assert result["mask"].shape == mask.shape
    as_floats = A.Compose([MlsWarp(p=1)], seed=1)(image=picture.astype(np.float32) / 255)
    as_bytes = A.Compose([MlsWarp(p=1)], seed=1)(image=picture)
    difference = np.abs(as_floats["image"] * 255 - as_bytes["image"])
    assert np.median(difference) < 1
    assert "sigma" in repr(MlsWarp())


def test_the_hook_of_albumentationsx_is_chosen(monkeypatch):
    """A stub with the shape of that library, which refuses the other hook."""

    class Basic:
        def sample_parameters(self, params, data, targets, sampling):
            raise NotImplementedError

    class Dual(Basic):
        def __init__(self, p):
            self.p = p

        def __init_subclass__(cls):
            assert "get_params_dependent_on_data" not in cls.__dict__

    def module(name, **content):
        made = types.ModuleType(name)
        made.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, made)
        return made

    class Sampled:
        def __init__(self, params):
            self.params = params

    targets = types.SimpleNamespace(IMAGE=1, MASK=2, BBOXES=3, KEYPOINTS=4)
    module("albumentations", DualTransform=Dual, BasicTransform=Basic)
    module("albumentations.core")
    module("albumentations.core.type_definitions", Targets=targets)
    module("albumentations.core.transform_params", SampledParams=Sampled)
    monkeypatch.delitem(sys.modules, "mlswarp.augment.albumentations")
    from mlswarp.augment.albumentations import MlsWarp as Stubbed

    sampling = types.SimpleNamespace(random_generator=np.random.default_rng(0))
    sampled = Stubbed(sigma=2).sample_parameters({"shape": (H, W, 3)}, {}, None, sampling)
    assert sampled.params["pose"].plan.size == (W, H)


def test_the_readme_runs(monkeypatch):
    text = (ROOT / "api/python/README.md").read_text()
    monkeypatch.chdir(ROOT / "tests/images")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) >= 5
    names = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert names["warped"].shape == np.asarray(Image.open("astronaut.png")).shape
    assert names["moved"].shape[2] == 8
