"""The widget for notebooks: its traits, and its front in Chromium on a page that does what a
notebook does."""

import doctest
import importlib
import json
import subprocess
import sys
from base64 import b64encode
from io import BytesIO
from pathlib import Path

import mlswarp
import numpy as np
import pytest
import traitlets
from mlswarp.widget import WarpWidget
from PIL import Image
from playwright.sync_api import sync_playwright

from conftest import CAT_SIZE, CHROMIUM, FLAGS, PICTURES, ROOT

P = ((168.0, 112.0), (316.0, 136.0), (262.0, 240.0))
Q = ((150.0, 104.0), (338.0, 126.0), (262.0, 262.0))


@pytest.fixture(scope="module")
def pixels(cat):
    return np.asarray(Image.open(BytesIO(cat)).convert("RGB"))


def test_traits_are_tuples_that_can_be_observed(pixels):
    widget = WarpWidget(pixels, np.array(P), height=200)
    heard = []
    widget.observe(lambda change: heard.append(change.new), "q")
    assert widget.p == widget.q == P
    widget.q = [list(place) for place in Q]
    # What comes from a front, and the same again.
    for _ in range(2):
        widget.set_state({"q": [list(place) for place in P]})
    assert heard == [Q, P]
    # A new handle comes with both sides; handles of another number are at rest.
    widget.set_state({"p": [[1, 2], [[3, 4], [5, 6]]], "q": [[1, 2], [[3, 4], [5, 7]]]})
    assert widget.q == ((1, 2), ((3, 4), (5, 7)))
    widget.p = P
    assert widget.q == P
    for name, wrong, code in [
        ("q", Q[:2], "shape_mismatch"),
        ("p", [[1, float("inf")]], "not_finite"),
        ("p", [[1, 2], None], "bad_value"),
        ("p", [[1, 2, 3]], "bad_value"),
    ]:
        with pytest.raises(mlswarp.InvalidWarp) as error:
            setattr(widget, name, wrong)
        assert (error.value.code, error.value.pointer[:2]) == (code, f"/{name}"), error.value
        assert widget.p == widget.q == P
    with pytest.raises(traitlets.TraitError):
        widget.method = "arap"
    with pytest.raises(traitlets.TraitError):
        widget.image_bytes = b""


def test_results_are_those_of_the_library(pixels, cat):
    widget = WarpWidget(pixels, P, Q, method="similarity")
    widget.strength = 0.5
    pose = mlswarp.Plan(P, like=pixels, method="similarity").pose(Q, strength=0.5)
    assert (widget.result() == pose.warp(pixels)).all()
    file = np.asarray(Image.open(BytesIO(mlswarp.warp_file(cat, widget.value))).convert("RGBA"))
    inside = file[:, :, 3] == 255
    assert (file[inside, :3] == widget.result()[inside]).all()
    assert (WarpWidget(pixels).result() == pixels).all()


def test_examples_of_docstrings():
    assert doctest.testmod(importlib.import_module("mlswarp.widget")).failed == 0


def test_images_of_all_kinds(pixels, cat, tmp_path):
    turned = BytesIO()
    exif = Image.Exif()
    exif[0x112] = 6
    Image.fromarray(pixels).save(turned, "JPEG", exif=exif)
    (tmp_path / "cat.tiff").write_bytes(cat)
    grey = pixels[:, :, 0]
    for image, shape, kind in [
        (cat, (*CAT_SIZE[::-1], 3), "PNG"),
        (turned.getvalue(), (*CAT_SIZE, 3), "JPEG"),
        (Image.fromarray(pixels), pixels.shape, "PNG"),
        (ROOT / "tests/images/chelsea.png", pixels.shape, "PNG"),
        (grey, grey.shape, "PNG"),
        (grey[:, :, None], (*grey.shape, 1), "PNG"),
        (pixels[:, :, :2], (*grey.shape, 2), "PNG"),
        (pixels.astype(np.uint16) << 8, pixels.shape, "PNG"),
    ]:
        widget = WarpWidget(image, [[9, 9]])
        assert widget.result().shape == shape
        assert widget.result().dtype == getattr(image, "dtype", np.uint8)
        with Image.open(BytesIO(widget.image_bytes)) as shown:
            assert shown.format == kind


def test_what_is_no_image_is_refused(pixels, cat, monkeypatch):
    for broken in (b"", b"no image", cat[: len(cat) // 2], pixels[:0]):
        with pytest.raises(mlswarp.BadImage):
            WarpWidget(broken)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    with pytest.raises(mlswarp.TooLarge):
        WarpWidget(cat)
    with pytest.raises(mlswarp.UnsupportedArray):
        WarpWidget(pixels.astype(float))


def test_the_extra_is_asked_for_only_by_the_widget(monkeypatch):
    code = "import mlswarp, sys; print(*({'anywidget', 'traitlets', 'PIL'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "\n"
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "mlswarp.widget")
    with pytest.raises(ImportError, match=r"pip install 'mlswarp\[widget\]'"):
        importlib.import_module("mlswarp.widget")


@pytest.fixture
def notebook():
    """A page of a site that has nothing else."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 640, "height": 760})
        trouble = []
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on(
            "console", lambda told: told.type in ("error", "warning") and trouble.append(told.text)
        )
        page.route("**/*", lambda route: route.abort())
        host = Path(__file__).with_name("widget.html").read_text()
        page.route(
            "http://localhost/", lambda route: route.fulfill(body=host, content_type="text/html")
        )
        page.goto("http://localhost/")
        yield page
        assert trouble == []
        browser.close()


def test_a_drag_in_a_notebook_is_seen_by_python(notebook, pixels):
    page = notebook
    widget = WarpWidget(pixels, P, height=320)
    page.expose_function("kernel", lambda changed: widget.set_state(changed))
    state = {name: widget.get_state()[name] for name in ("height", "tool", *widget.value)}
    image = b64encode(widget.image_bytes).decode()
    page.evaluate(
        "([given]) => show(...given)", [[widget._esm, json.loads(json.dumps(state)), image]]
    )

    def both(name):
        first, second = page.evaluate(
            f"[...document.querySelectorAll('mls-warp')].map((e) => e.{name})"
        )
        assert json.dumps(first) == json.dumps(second)
        return first

    def tuples(handles):
        return tuple(map(tuple, handles))

    def rest():
        shown = "[...document.querySelectorAll('mls-warp')].every((e) => e.state === 'ready')"
        page.wait_for_function(shown, timeout=30_000)

    rest()
    box = page.locator("#first #handle-2").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y + 20, steps=30)
    page.wait_for_timeout(50)
    assert widget.q != P, "while the handle is dragged"
    page.mouse.move(x + 40, y + 25, steps=10)
    saved = [one["frame"] for one in page.evaluate("model.saves")]
    assert len(saved) == len(set(saved)) > 2, "at most one message in a frame"
    page.mouse.up()
    rest()
    assert widget.p == P and widget.q[:2] == P[:2]
    assert np.allclose(np.subtract(widget.q[2], P[2]), (40 / 320 * 300, 25 / 320 * 300), atol=6)
    assert tuples(both("q")) == widget.q
    assert {name for one in page.evaluate("model.saves") for name in one["names"]} == {"q"}
    # What the browser drew is what Python computes.
    file = page.evaluate("""async () => {
      const file = await document.querySelector("mls-warp").toBlob();
      return [...new Uint8Array(await file.arrayBuffer())];
    }""")
    drawn = np.asarray(Image.open(BytesIO(bytes(file))).convert("RGBA"))
    inside = drawn[:, :, 3] == 255
    assert (drawn[inside, :3] == widget.result()[inside]).all() and inside.mean() > 0.9
    page.screenshot(path=PICTURES / "widget.png")

    # What Python sets, both views show; what one of them adds, Python has.
    widget.q = Q
    widget.tool = "line"
    page.evaluate(
        "(state) => model.receive(state)", {"q": [list(place) for place in Q], "tool": "line"}
    )
    rest()
    assert tuples(both("q")) == Q and both("tool") == "line"
    widget.tool = "point"
    page.evaluate("model.receive({ tool: 'point' })")
    stage = page.locator("#second #stage").bounding_box()
    page.mouse.click(stage["x"] + stage["width"] / 4, stage["y"] + stage["height"] * 0.8)
    rest()
    assert len(widget.p) == len(both("p")) == 4 and widget.q[:3] == Q
    page.evaluate("ends.forEach((end) => end())")
    assert page.locator("mls-warp").count() == 0
    assert page.evaluate("Object.values(model.heard).flat().length") == 0
