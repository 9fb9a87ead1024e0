"""The region: drawn by lasso and brush, what moves is inside of it, and everything else is the
picture, bit for bit."""

import io
import shutil

import pytest
from PIL import Image, ImageChops, ImageDraw

from support import BLUE, BROKEN, GREEN, RED, Fingers, Server, near
from test_output import run

# Around the red disc, and where it is dragged: within the region's reach, apart from the other
# discs.
AROUND = ((60, 60), (150, 60), (150, 150), (60, 150))
GOAL = (110, 150)


def closed(places):
    return (*places, places[0])


def bend(visit, picture):
    visit.open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, GOAL)
    visit.ready()
    return visit


@pytest.fixture
def bent(visit, picture):
    return bend(visit, picture)


def rgba(png):
    return Image.open(io.BytesIO(png)).convert("RGBA")


def changed(visit, picture):
    """The box in which the server's PNG differs from the source."""
    visit.ready()
    png = visit.saved("download")[1]
    assert png == visit.of_server().body
    return difference(png, picture), png


def difference(png, picture):
    """The box in which a PNG differs from the source."""
    return ImageChops.difference(rgba(png), Image.open(picture).convert("RGBA")).getbbox(
        alpha_only=False
    )


def inside(box, outer):
    return (
        box and all(outer[k] <= box[k] for k in (0, 1)) and all(box[k] <= outer[k] for k in (2, 3))
    )


def by_mouse(visit):
    visit.page.click("label:has(#tool-lasso)")
    visit.drag(*closed(AROUND))


def by_corners(visit):
    visit.page.click("label:has(#tool-lasso)")
    for place in AROUND:
        visit.click(*place)
    visit.body("[data-draft='4']")
    visit.page.click("#draft-finish")


def by_keyboard(visit):
    visit.page.focus("#stage")
    visit.keys("4", "ArrowUp")
    for place in AROUND:
        move_cross(visit, place)
        visit.keys("Enter")
    visit.keys("Enter")


def by_touch(visit):
    fingers = Fingers(visit)
    box = visit.page.locator("label:has(#tool-lasso)").bounding_box()
    fingers.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    fingers.put(a=visit.at(*AROUND[0]))
    for place in (*AROUND[1:], AROUND[0]):
        fingers.move(a=visit.at(*place))
    fingers.lift()


def by_brush(visit):
    visit.page.click("label:has(#tool-brush)")
    visit.page.locator("#brush-size").fill("60")
    visit.drag((90, 90), (120, 90), (120, 120), (90, 120), (105, 105))


def by_brush_and_keyboard(visit):
    visit.page.focus("#stage")
    visit.keys("5", *["]"] * 7)
    assert int(visit.text("brush-size-value").split()[0]) > 80
    move_cross(visit, (105, 105))
    visit.keys("Enter")


def move_cross(visit, goal):
    """By the arrow keys, from wherever it is."""
    visit.keys("ArrowRight")
    x, y = (int(c) for c in visit.text("says").split(", "))
    for at, to, more, less in (
        (x, goal[0], "ArrowRight", "ArrowLeft"),
        (y, goal[1], "ArrowDown", "ArrowUp"),
    ):
        visit.keys(
            *[more if to > at else less] * (abs(to - at) // 10),
            *[f"Shift+{more if to > at else less}"] * (abs(to - at) % 10),
        )
    assert visit.text("says") == f"{goal[0]}, {goal[1]}"


def test_only_the_region_moves(visits, picture):
    visit = bend(visits(has_touch=True), picture)
    whole, _ = changed(visit, picture)
    assert not inside(whole, (50, 50, 350, 250)), "without a region everything moves"
    for draws in (by_mouse, by_corners, by_keyboard, by_touch, by_brush, by_brush_and_keyboard):
        visit.keys("Escape")
        draws(visit)
        visit.body("[data-region='1']")
        visit.ready()
        png = visit.of_server().body
        # The content of the region moved down by 50 px at most; the red disc is there and, as holes
        # keep the picture, also where it was.
        box = difference(png, picture)
        assert inside(box, (55, 55, 165, 215)), (draws, box)
        assert rgba(png).getpixel(GOAL)[0] > 200 > 100 > rgba(png).getpixel(GOAL)[1], draws
        visit.keys("Control+z")
        visit.body("[data-region='0']")
    assert changed(visit, picture)[0] == whole
    visit.keys("Control+Shift+z")
    assert changed(visit, picture) == (box, png)


def test_the_preview_of_a_drag_is_the_servers_picture(bent, picture):
    by_mouse(bent)
    bent.page.locator("#feather").fill("20")
    bent.page.click("label:has(#tool-point)")
    bent.ready()
    for holes in ("keep", "transparent"):
        bent.page.select_option("#holes", holes)
        bent.ready()
        assert holes in ("keep",) or bent.warp()["output"] == {"holes": "transparent"}
        with bent.without_pictures():
            bent.drag(GOAL, (140, 160))
            bent.body(f"[data-source=mesh][data-moving=false][data-shown='{bent['revision']}']")
            moving = bent.look()
        bent.ready()
        resting = bent.look()
        # Visible differences are those of the enlargement, along edges.
        assert resting.differs(moving) < 0.01 * moving.image.width * moving.image.height
        # The place that the disc has left, and one that never changes.
        left, stays = resting.colour(*RED), resting.colour(250, 40)
        assert (left[0] > 200 and left[2] < 60) == (holes == "keep"), left
        assert stays == moving.colour(250, 40) == (200, 200, 200)
        bent.keep(f"region-{holes}")
        bent.keys("Control+z")
        bent.ready()
    png = rgba(bent.saved("download")[1])
    assert png.getpixel(RED)[3] < 16 and png.getpixel((250, 40)) == (200, 200, 200, 255)


def test_it_is_removed_inverted_and_cleared(bent, picture):
    """Without a region, what is removed leaves the rest; an inverted region moves what stayed."""
    bent.page.click("label:has(#tool-lasso)")
    bent.keys("x")
    assert bent.page.locator("#region-removes").is_checked()
    bent.drag(*closed(AROUND))
    bent.body("[data-region='2']")
    removed, png = changed(bent, picture)
    assert rgba(png).getpixel(GOAL) == (200, 200, 200, 255), "the disc does not move"
    bent.page.click("#region-invert")
    box, _ = changed(bent, picture)
    assert inside(box, (55, 55, 165, 215)) and not inside(removed, (55, 55, 165, 215))
    bent.page.click("#region-clear")
    assert bent["region"] == "0" and bent.page.locator("#region-clear").is_disabled()
    cleared, _ = changed(bent, picture)
    assert not inside(cleared, (55, 55, 165, 215))
    for region in ("3", "2", "0"):
        bent.page.click("#undo")
        bent.body(f"[data-region='{region}']")
    assert changed(bent, picture)[0] == cleared


def test_it_survives_a_reload_and_an_expired_session(visits, picture):
    server = Server()
    try:
        visit = bend(visits(server), picture)
        visit.expects("404", "410", *BROKEN)
        by_mouse(visit)
        visit.page.locator("#feather").fill("12")
        box, png = changed(visit, picture)
        visit.body("[data-kept=true]")
        visit.page.reload()
        assert (
            changed(visit, picture) == (box, png)
            and visit["region"] == "1"
            and visit.text("feather-value") == "12 px"
        )
        assert server.ask("DELETE", f"/sessions/{visit['session']}").status == 204
        visit.drag(GOAL, (110, 140))
        smaller, _ = changed(visit, picture)
        assert inside(smaller, (40, 40, 175, 225))
        visit.keys("Control+z")
        assert changed(visit, picture) == (box, png)
        visit.body("[data-kept=true]")
        server.kill()
        server.start()
        visit.page.reload()
        assert changed(visit, picture) == (box, png)
    finally:
        server.stop()


def test_it_is_in_the_command_and_behind_the_link(bent, visits, picture, tmp_path):
    by_mouse(bent)
    box, png = changed(bent, picture)
    shutil.copy(picture, tmp_path)
    with bent.page.expect_download() as mask:
        line = bent.copied("copy-curl")
    assert mask.value.suggested_filename == "discs-region.png" and "discs-region.png" in bent.text(
        "toast"
    )
    mask.value.save_as(tmp_path / "discs-region.png")
    drawn = Image.open(tmp_path / "discs-region.png").convert("L")
    assert drawn.size == (400, 300) and drawn.getpixel(RED) == 255 and drawn.getpixel(BLUE) == 0
    run(line, tmp_path)
    assert (tmp_path / "discs-warped.png").read_bytes() == png
    # The page of a link draws and, when it changes a handle, opens its own session with the same
    # region.
    link = bent.copied("copy-link")
    other = visits(path=link[link.index("#") :])
    assert changed(other, picture) == (box, png) and other["region"] == "1"
    session = other["session"]
    other.page.click("label:has(#method-similarity)")
    other.ready()
    assert other["session"] != session
    assert inside(changed(other, picture)[0], (55, 55, 165, 215))


def test_a_stroke_that_is_cancelled_leaves_nothing(bent):
    bent.page.click("label:has(#tool-brush)")
    undo = bent["undo"]
    bent.press((200, 100), (250, 100))
    bent.page.wait_for_selector("#region")
    assert bent.page.locator("#brush-at").is_visible()
    bent.keys("Escape")
    bent.page.mouse.up()
    assert bent["region"] == "0" and bent["undo"] == undo
    bent.page.wait_for_selector("#region", state="hidden")
    # A larger brush is shown where the pointer is.
    narrow = bent.page.locator("#brush-at").bounding_box()
    bent.keys("]")
    wide = bent.page.locator("#brush-at").bounding_box()
    assert wide["width"] > narrow["width"] and near(
        [wide["x"] + wide["width"] / 2], [narrow["x"] + narrow["width"] / 2], 1
    )
    # A lasso along a line encloses nothing, with which nothing could move.
    bent.page.click("label:has(#tool-lasso)")
    for line in ((RED, (300, 100)), (RED, (300, 100), RED), ((200, 100), RED, (300, 100))):
        bent.drag(*line)
        assert (
            bent["region"] == "0"
            and bent["undo"] == undo
            and bent.text("says") == "The lasso encloses nothing"
        )
    # Keys do not reach a handle that the tool hides.
    bent.page.click("label:has(#tool-point)")
    bent.page.focus("#handle-0")
    bent.keys("4", "ArrowUp", "Enter", "Delete", "Escape")
    assert (bent["tool"], bent["undo"], bent["handles"]) == ("lasso", undo, "3")
    # Selecting handles leaves the tool, which hides them.
    assert not bent.page.locator("#handle-0").is_visible()
    bent.page.click("#select-all")
    assert (
        bent["tool"] == "point"
        and bent["selected"] == "3"
        and bent.page.locator("#handle-0").is_visible()
    )
    assert near(bent.posed(0), GOAL, 1)


def test_the_overlay_can_be_seen_with_every_tool(bent):
    by_mouse(bent)
    shown = bent.page.locator("#region")
    shown.wait_for()
    assert bent.page.locator("#region-shown").is_checked()
    bent.page.click("label:has(#tool-point)")
    shown.wait_for(state="hidden")
    plain = bent.look()
    bent.page.check("#region-shown")
    shown.wait_for()
    covered = bent.look()
    assert covered.colour(250, 40) != plain.colour(250, 40)
    assert near(covered.colour(100, 70), plain.colour(100, 70), 1), "the region itself is clear"


def cutout(path):
    """A disc on nothing."""
    image = Image.new("RGBA", (400, 300), (0, 0, 0, 0))
    ImageDraw.Draw(image).ellipse((60, 60, 140, 140), fill=(230, 20, 20, 255))
    image.save(path)
    return path


def surrounded(visit):
    """The red disc moves in a region of its own."""
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((40, 40), (160, 40), (160, 160), (40, 160))
    visit.page.click("label:has(#tool-point)")
    visit.click(*RED)
    visit.ready()
    return visit


def seen_at(visit, x, y):
    return Image.open(io.BytesIO(visit.saved("download")[1])).convert("RGBA").getpixel((x, y))[3]


def test_a_cut_out_leaves_nothing_where_it_was(visit, tmp_path):
    visit.open(cutout(tmp_path / "disc.png"))
    surrounded(visit)
    assert visit.page.input_value("#holes") == "transparent"
    visit.drag(RED, (250, 200))
    visit.ready()
    assert seen_at(visit, 250, 200) == 255 and seen_at(visit, *RED) == 0
    assert not visit.page.locator("#holes-hint").is_visible()
    # The choice of the user stays, whatever the region.
    visit.page.select_option("#holes", "keep")
    visit.ready()
    assert seen_at(visit, *RED) == 255 and visit.page.locator("#holes-hint").is_visible()
    visit.page.click("#region-clear")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((40, 40), (160, 40), (160, 160), (40, 160))
    visit.ready()
    assert visit.page.input_value("#holes") == "keep"


def test_the_old_place_is_offered_to_be_transparent(opened):
    surrounded(opened)
    hint = opened.page.locator("#holes-hint")
    assert opened.page.input_value("#holes") == "keep" and not hint.is_visible(), (
        "nothing has moved"
    )
    opened.press(RED, (250, 200))
    assert not hint.is_visible(), "not under a pointer"
    opened.page.mouse.up()
    opened.ready()
    assert hint.is_visible() and seen_at(opened, *RED) == 255
    opened.page.click("#holes-clear")
    opened.ready()
    assert not hint.is_visible() and seen_at(opened, *RED) == 0
    opened.page.click("#undo")
    opened.ready()
    opened.page.click("#holes-close")
    assert not hint.is_visible() and opened.page.input_value("#holes") == "keep"
