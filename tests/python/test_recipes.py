"""The recipe for torchvision. Its packages for Linux bring gigabytes for graphics cards, so that it
runs on stand-ins with their names, which are arrays, unless the library itself is installed, as it
is by `tests/run --full`."""

import importlib.util
import runpy
import sys
import types

import numpy as np
import pytest

from conftest import ROOT

H, W = 90, 120


def stand_ins():
    """What the recipe names of torch and torchvision, with the same meaning."""

    class Tensor(np.ndarray):
        def numpy(self):
            return np.asarray(self)

        def to(self, dtype):
            return self.astype(dtype)

    def from_numpy(array):
        return array.view(Tensor)

    def kind(name):
        def new(cls, tensor, **meta):
            made = tensor.view(cls)
            made.__dict__.update(meta)
            return made

        return type(name, (Tensor,), {"__new__": new})

    kinds = {name: kind(name) for name in ("Image", "Mask", "BoundingBoxes", "KeyPoints")}

    def wrap(tensor, *, like, **meta):
        return type(like)(tensor, **{**like.__dict__, **meta})

    def get_size(tensor):
        return list(getattr(tensor, "canvas_size", tensor.shape[-2:]))

    def convert_bounding_box_format(boxes, new_format):
        if boxes.format == new_format:
            return boxes
        sign = 1 if new_format == "XYXY" else -1
        moved = np.array(boxes)
        moved[:, 2:] += sign * moved[:, :2]
        return wrap(from_numpy(moved), like=boxes, format=new_format)

    class Transform:
        def __call__(self, sample):
            params = self.make_params(list(sample.values()))
            return {name: self.transform(value, params) for name, value in sample.items()}

    rng = [np.random.default_rng(0)]

    def manual_seed(seed):
        rng[0] = np.random.default_rng(seed)

    functional = {"get_size": get_size, "convert_bounding_box_format": convert_bounding_box_format}
    return {
        "torch": {
            "from_numpy": from_numpy,
            "manual_seed": manual_seed,
            "randint": lambda high, _size: rng[0].integers(high),
        },
        "torchvision": {},
        "torchvision.tv_tensors": {**kinds, "wrap": wrap},
        "torchvision.transforms": {},
        "torchvision.transforms.v2": {"Transform": Transform},
        "torchvision.transforms.v2.functional": functional,
    }


@pytest.fixture
def vision(monkeypatch):
    # One that is there and cannot be imported is a failure, no reason for stand-ins.
    if importlib.util.find_spec("torchvision") is None:
        for name, content in stand_ins().items():
            module = types.ModuleType(name)
            module.__dict__.update(content)
            monkeypatch.setitem(sys.modules, name, module)
            parent, _, last = name.rpartition(".")
            if parent:
                setattr(sys.modules[parent], last, module)
    return importlib.import_module("torch"), importlib.import_module("torchvision.tv_tensors")


def test_torchvision_moves_everything_alike(vision):
    torch, tv_tensors = vision
    recipe = runpy.run_path(str(ROOT / "api/python/examples/torchvision_warp.py"))
    warp = recipe["MlsWarp"](sigma=5, grid=(5, 4))
    dots, places = np.zeros((3, H, W), np.uint8), [[40, 50], [90, 30], [77, 70]]
    for x, y in places:
        dots[:, y, x] = 255
    mask = np.zeros((2, H, W), np.int32)
    mask[0, 20:60, 30:90] = 70_000

    def made(kind, values, **meta):
        return getattr(tv_tensors, kind)(torch.from_numpy(np.array(values)), **meta)

    box, on = np.array([[30, 20, 60, 40]], np.float32), {"canvas_size": (H, W)}
    sample = {
        "image": made("Image", dots),
        "mask": made("Mask", mask),
        "boxes": made("BoundingBoxes", box, format="XYWH", **on),
        "points": made("KeyPoints", np.array(places, np.float32), **on),
    }
    torch.manual_seed(7)
    moved = warp(sample)
    again = warp(sample)
    torch.manual_seed(7)
    third = warp(sample)
    arrays = {name: value.numpy() for name, value in moved.items()}
    assert (arrays["image"] == third["image"].numpy()).all(), "a seed repeats"
    assert (arrays["image"] != again["image"].numpy()).any()
    for name, value in sample.items():
        assert type(moved[name]) is type(value)
        assert (arrays[name].shape, arrays[name].dtype) == (value.shape, value.numpy().dtype)
    for x, y in arrays["points"]:
        left, top = int(x) - 3, int(y) - 3
        near = arrays["image"][0, top : top + 8, left : left + 8].astype(float)
        rows, columns = np.mgrid[top : top + 8, left : left + 8]
        seen = np.array([(columns * near).sum(), (rows * near).sum()]) / near.sum()
        assert np.abs(seen - (x, y)).max() < 0.25
    assert set(np.unique(arrays["mask"])) == {0, 70_000} and not arrays["mask"][1].any()
    rows, columns = np.nonzero(arrays["mask"][0])
    left, top, width, height = arrays["boxes"][0]
    edges = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert np.abs(np.array([left, top, left + width, top + height]) - edges).max() <= 1.01
    with pytest.raises(TypeError, match=r"pose\.map\(\)"):
        warp({"image": made("Image", dots.astype(np.float32))})
