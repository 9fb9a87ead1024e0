"""The canvas: the whole result or a box instead of the area of the picture, in the preview, the
server's picture and every export."""

import io
import json

import pytest
from PIL import Image

from support import BLUE, GREEN, RED

FIELDS = ("x", "y", "width", "height")


@pytest.fixture
def shifted(opened):
    """Everything 60 px to the right and 20 px up."""
    opened.click(*RED)
    opened.drag(RED, (RED[0] + 60, RED[1] - 20))
    opened.ready()
    return opened


def choose(visit, canvas):
    if visit.page.input_value("#canvas") != canvas:
        visit.page.select_option("#canvas", canvas)
    visit.ready()
    png = visit.saved("download")[1]
    assert png == visit.of_server().body
    return Image.open(io.BytesIO(png)).convert("RGBA")


def shown(visit):
    return [int(number) for number in visit["canvas"].split(",")]


def near(a, b, by=3):
    return all(abs(m - n) <= by for m, n in zip(a, b, strict=True))


def test_the_whole_result_is_shown_saved_and_undone(shifted):
    picture = Image.open(io.BytesIO(shifted.saved("download")[1]))
    assert "60 px on the right" in shifted.text("canvas-note") and "20 px above" in shifted.text(
        "canvas-note"
    )
    assert not shifted.page.locator("#ruler").is_visible()
    before = shifted.look().centre("red")
    shifted.page.click("#canvas-all")
    shifted.ready()
    assert shifted.page.input_value("#canvas") == "fit" and shown(shifted) == [
        60,
        -20,
        *picture.size,
    ]
    whole = choose(shifted, "fit")
    assert whole.size == picture.size
    # What was cut off is there, and handles are where they were in the picture.
    assert whole.getpixel((whole.width - 1, 0))[3] == 255
    assert near(shifted.look().centre("red"), before)
    assert near(shifted.posed(0), (RED[0] + 60, RED[1] - 20))
    assert [
        shifted.page.locator(f"#ruler [data-edge={edge}]").inner_text() for edge in ("left", "top")
    ] == ["60", "-20"]
    assert not shifted.page.locator("#canvas-all").is_visible()
    shifted.keep("canvas-fit")
    shifted.page.click("#undo")
    shifted.ready()
    assert (
        shifted.page.input_value("#canvas") == "same"
        and Image.open(io.BytesIO(shifted.saved("download")[1])).size == picture.size
    )
    assert not shifted.page.locator("#ruler").is_visible()


@pytest.mark.parametrize("query", ["", "?webgl=off"])
def test_the_preview_shows_the_canvas_too(visits, picture, query):
    visit = visits(query=query).open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    choose(visit, "fit")
    with visit.without_pictures():
        visit.drag(RED, (RED[0] - 80, RED[1]))
        kind = "mesh" if not query else "frame"
        visit.body(f"[data-source={kind}][data-moving=false][data-shown='{visit['revision']}']")
        left, top, *_ = shown(visit)
        assert left < 0
        moving = visit.page.screenshot()
    visit.ready()
    assert shown(visit)[0] == left
    resting = visit.page.screenshot()
    # The same picture at the same place.
    one, other = (Image.open(io.BytesIO(shot)).convert("L") for shot in (moving, resting))
    red, green, blue = visit.at(-5, RED[1] + 40), visit.at(*GREEN), visit.at(*BLUE)
    for x, y in (red, green, blue):
        assert abs(one.getpixel((int(x), int(y))) - other.getpixel((int(x), int(y)))) <= 12


def test_frames_that_are_asked_for_one_by_one_show_the_canvas(visits, picture):
    visit = visits(query="?webgl=off&socket=off&plan=off").open(picture)
    visit.click(*RED)
    choose(visit, "fit")
    visit.ready()
    visit.page.evaluate(
        """() => {
          window.boxes = [];
          const { dataset } = document.body;
          const note = () => dataset.source === "frame" && window.boxes.push(dataset.canvas);
          new MutationObserver(note).observe(document.body, { attributeFilter: ["data-shown"] });
        }"""
    )
    visit.press(RED, (RED[0] - 60, RED[1]))
    for step in range(200):
        visit.page.mouse.move(*visit.at(RED[0] - 60 - step % 2, RED[1]))
        if visit.page.evaluate("boxes.length > 1"):
            break
    visit.page.mouse.up()
    visit.ready()
    boxes = [[float(c) for c in box.split(",")] for box in visit.page.evaluate("boxes")]
    assert boxes and all(box[2:] == [400, 300] for box in boxes), boxes
    assert boxes[-1][0] < 0, boxes


def test_a_box_is_typed_checked_kept_and_exported(shifted):
    choose(shifted, "box")
    assert [shifted.page.input_value(f"#canvas-{name}") for name in FIELDS[:2]] == ["0", "0"]
    box = {"x": -20, "y": -30, "width": 150, "height": 90}
    for name, value in box.items():
        shifted.page.fill(f"#canvas-{name}", str(value))
        shifted.page.press(f"#canvas-{name}", "Tab")
        shifted.ready()
    assert Image.open(io.BytesIO(shifted.saved("download")[1])).size == (150, 90) and shown(
        shifted
    ) == list(box.values())
    assert shifted.warp()["output"]["canvas"] == box
    # The command gives the same file.
    assert json.dumps(box, separators=(",", ":")) in shifted.copied("copy-curl")
    # What is being typed stays when a picture arrives.
    with shifted.without_pictures():
        shifted.page.fill("#canvas-x", "-21")
        shifted.page.press("#canvas-x", "Tab")
        shifted.page.fill("#canvas-width", "15")
    shifted.ready()
    assert shifted.page.input_value("#canvas-width") == "15"
    shifted.page.fill("#canvas-x", "-20")
    shifted.page.fill("#canvas-width", "150")
    shifted.page.press("#canvas-width", "Tab")
    shifted.ready()
    # A wrong number changes nothing.
    shifted.page.fill("#canvas-width", "0")
    shifted.page.press("#canvas-width", "Tab")
    assert shifted.page.get_attribute("#canvas-width", "aria-invalid") == "true"
    assert shifted.warp()["output"]["canvas"] == box
    shifted.keep("canvas-box")
    shifted.page.reload()
    shifted.ready()
    assert (
        shown(shifted) == list(box.values()) and shifted.page.input_value("#canvas-width") == "150"
    )
