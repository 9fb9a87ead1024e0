"""What is in front where the picture overlaps itself."""

import io

from PIL import Image

from test_outline import RIGHT, stood


def drawn(visit):
    visit.ready()
    return Image.open(io.BytesIO(visit.saved("download")[1])).convert("RGBA")


def test_what_is_dragged_in_a_cut_out_comes_to_the_front(visit, tmp_path):
    stood(visit, tmp_path / "legs.png")
    assert "depth" not in visit.warp()
    visit.drag(RIGHT, (100, 260))
    visit.ready()
    assert visit.warp()["depth"] == [0, 1, 0, 0]
    in_front = drawn(visit)
    assert in_front.tobytes() == Image.open(io.BytesIO(visit.of_server().body)).tobytes()
    visit.page.click("#send-back")
    behind = drawn(visit)
    assert visit.warp()["depth"] == [0, -1, 0, 0]
    assert behind.tobytes() != in_front.tobytes()
    visit.page.click("#bring-front")
    assert drawn(visit).tobytes() == in_front.tobytes()
    # It is in front already.
    revision = visit.data["revision"]
    visit.page.click("#bring-front")
    assert visit.data["revision"] == revision
    visit.keep("depth")


def test_the_table_has_the_depth_and_undo_takes_it_back(opened):
    for place in ((60, 60), (200, 60), (120, 150)):
        opened.click(*place)
    opened.body("[data-handles='3']").ready()
    opened.page.fill("#depth-1", "2.5")
    opened.page.keyboard.press("Enter")
    opened.ready()
    assert opened.warp()["depth"] == [0, 2.5, 0]
    opened.page.click("#undo")
    opened.ready()
    assert "depth" not in opened.warp()
    assert opened.page.input_value("#depth-1") == ""
    # A photograph has no outline: what is dragged stays where it is in the order.
    opened.drag((200, 60), (140, 80))
    opened.ready()
    assert "depth" not in opened.warp()
