"""The content outside the warped picture: transparent, extended edge, solid colour. The same in the
live preview and in the server's picture."""

import io
import json
import shutil

import pytest
from PIL import Image

from support import BLUE, GREEN, RED, Server
from test_output import run

# A place that the picture has left, and the colour of the edge that is nearest.
BARE, GREY, PURPLE = (12, 150), (200, 200, 200), "#8020c0"


@pytest.fixture
def shifted(opened):
    """Everything 60 px to the right: a strip on the left is bare."""
    opened.click(*RED)
    opened.drag(RED, (160, 100))
    opened.ready()
    return opened


def at(png, x, y):
    return Image.open(io.BytesIO(png)).convert("RGBA").getpixel((x, y))


def choose(visit, outside, colour=None):
    """Until the server's picture of it is seen: its bytes."""
    if visit.page.input_value("#outside") != outside:
        visit.page.select_option("#outside", outside)
    if colour:
        visit.page.fill("#outside-colour", colour)
    visit.ready()
    png = visit.saved("download")[1]
    assert png == visit.of_server().body
    return png


def close(a, b):
    return max(abs(m - n) for m, n in zip(a, b, strict=True)) <= 3


def test_each_choice_is_drawn_and_undone(shifted):
    notes = {shifted.text("outside-note")}
    assert not shifted.page.locator("#outside-colour").is_visible()
    assert at(shifted.saved("download")[1], *BARE) == (0, 0, 0, 0)
    assert at(choose(shifted, "edge"), *BARE) == (*GREY, 255)
    notes.add(shifted.text("outside-note"))
    assert at(choose(shifted, "colour"), *BARE) == (255, 255, 255, 255)
    notes.add(shifted.text("outside-note"))
    assert at(choose(shifted, "colour", PURPLE), *BARE) == (128, 32, 192, 255)
    assert len(notes) == 3
    assert close(shifted.look().colour(*BARE), (128, 32, 192))
    # The colours that are passed while one is looked for are one step of undo.
    for outside, pixel in (
        ("colour", (255, 255, 255, 255)),
        ("edge", (*GREY, 255)),
        ("transparent", (0, 0, 0, 0)),
    ):
        shifted.page.click("#undo")
        shifted.ready()
        assert shifted.page.input_value("#outside") == outside
        assert at(shifted.saved("download")[1], *BARE) == pixel


@pytest.mark.parametrize("query", ["", "?webgl=off"])
@pytest.mark.parametrize("outside, pixel", [("edge", GREY), ("colour", (128, 32, 192))])
def test_it_is_there_while_the_hand_moves(visits, picture, query, outside, pixel):
    visit = visits(query=query).open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    choose(visit, outside, PURPLE if outside == "colour" else None)
    with visit.without_pictures():
        # Turned and moved, so that all four sides and a corner have something beside them.
        visit.drag(RED, (150, 130))
        visit.drag(BLUE, (230, 200))
        shown = "mesh" if not query else "frame"
        visit.body(f"[data-source={shown}][data-moving=false][data-shown='{visit['revision']}']")
        assert close(visit.look().colour(*BARE), pixel)
        moving = visit.look()
    visit.ready()
    assert close(visit.look().colour(*BARE), pixel)
    # Edges differ a little: the browser enlarges the one and draws the other. The bare strip alone
    # is a tenth of the picture.
    assert visit.look().differs(moving) < 0.03 * moving.image.width * moving.image.height


def test_it_is_taken_along(shifted, visits, picture, tmp_path):
    assert "output" not in shifted.warp(), "what is usual is not said"
    png = choose(shifted, "colour", PURPLE)
    assert shifted.warp()["output"] == {"outside": "#8020c0ff"}
    shutil.copy(picture, tmp_path)
    run(shifted.copied("copy-curl"), tmp_path)
    assert (tmp_path / "discs-warped.png").read_bytes() == png
    # A link, whose picture the other one's command asks of the session.
    link = shifted.copied("copy-link")
    other = visits(path=link[link.index("#") :])
    other.ready()
    assert other.page.input_value("#outside-colour") == PURPLE and other.saved("download")[1] == png
    run(other.copied("copy-curl"), tmp_path)
    assert (tmp_path / "discs-warped.png").read_bytes() == png
    assert at(choose(other, "edge"), *BARE) == (*GREY, 255)
    # A reload, and a file of handles.
    shifted.page.reload()
    shifted.ready()
    assert (
        shifted.page.input_value("#outside-colour") == PURPLE
        and shifted.saved("download")[1] == png
    )
    name, handles = shifted.saved("save-handles")
    saved = tmp_path / name
    saved.write_text(json.dumps({**json.loads(handles), "output": {"outside": "#8020C080"}}))
    third = visits().open(picture)
    third.page.set_input_files("#file", saved)
    assert at(third.body("[data-handles='1']").ready() and third.saved("download")[1], *BARE) == (
        128,
        32,
        192,
        128,
    )
    # The field shows the colour; what lets through stays when it changes.
    assert at(choose(third, "colour", "#102030"), *BARE) == (16, 32, 48, 128)


def test_what_is_no_choice_is_refused(opened, tmp_path):
    wrong = tmp_path / "wrong-handles.json"
    wrong.write_text(json.dumps({"p": [[1, 2]], "q": [[3, 4]], "output": {"outside": "wrap"}}))
    opened.page.set_input_files("#file", wrong)
    opened.body("[data-problem=bad_handles_file][data-handles='0']")


def test_the_page_says_where_pictures_are_kept(visits, tmp_path):
    assert "in memory only" in visits().text("limits")
    server = Server("--store", f"file:{tmp_path / 'sessions'}")
    try:
        words = visits(of=server).text("limits")
        assert "memory" not in words and "15 idle minutes" in words
    finally:
        server.stop()
