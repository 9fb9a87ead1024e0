"""Picture and handles by mouse. Results are read from pixels."""

import io
import json
import math

import pytest
from PIL import Image, ImageChops

from support import BLUE, GREEN, RED, near


@pytest.fixture
def pinned(opened):
    """The three discs, each held by a point."""
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.body("[data-handles='3']").ready()
    return opened


def test_keys_work_after_a_click_into_the_header(pinned):
    pinned.click(*RED)
    pinned.page.click("#theme")
    pinned.keys("ArrowRight", "2")
    assert near(pinned.posed(0), (RED[0] + 1, RED[1]), 0.01) and pinned["tool"] == "line"
    # A dialog gives the focus back as well.
    pinned.page.click("#help-open")
    pinned.page.click("#help-close")
    pinned.page.wait_for_selector("#stage:focus")
    pinned.keys("ArrowRight")
    assert near(pinned.posed(0), (RED[0] + 2, RED[1]), 0.01)
    pinned.page.click("#select-all")
    pinned.keys("Delete")
    assert pinned["handles"] == "0"


def steps(visit):
    data = visit.data
    return int(data["undo"]), int(data["redo"])


def test_a_click_adds_a_handle_where_it_is(opened):
    before = opened.look()
    opened.click(120, 80)
    data = opened.ready()
    assert (data["handles"], data["selected"], data["undo"]) == ("1", "1", "1")
    assert near(opened.posed(0), (120, 80), 0.5)
    warp = opened.warp()
    assert warp["p"] == warp["q"]
    assert opened.look().differs(before) == 0


def test_a_handle_put_on_a_bent_picture_holds_what_is_under_the_cursor(pinned):
    pinned.drag(RED, (160, 150))
    pinned.ready()
    for place in ((230, 160), (70, 60), (160, 175)):
        # Asked of the picture as it is seen before the click: the point at rest lies where the
        # click saw it.
        bent = pinned.warp()
        pinned.click(*place)
        pinned.body(f"[data-handles='{len(bent['p']) + 1}']").ready()
        both = pinned.warp()
        rest, clicked = both["p"][-1], both["q"][-1]
        answer = pinned.server.ask(
            "POST", "/points", {**bent, "extent": [400, 300], "points": [rest]}
        )
        assert answer.status == 200, answer.body
        seen = json.loads(answer.body)["points"][0]
        assert near(seen, clicked, 0.3), (seen, clicked)
        assert not near(clicked, rest, 2), "a place that does not move shows nothing"


def test_the_picture_follows_the_hand_and_the_server_has_the_last_word(pinned):
    still = pinned.look()
    with pinned.without_pictures():
        pinned.press(RED, (130, 120))
        assert pinned["moving"] == "true"
        pinned.body(f"[data-moving=true][data-source=mesh][data-shown='{pinned['revision']}']")
        followed = pinned.look()
        assert followed.differs(still) > 500
        assert near(followed.centre("red"), (130, 120), 2.5)
        pinned.page.mouse.move(*pinned.at(150, 140), steps=3)
        pinned.body(f"[data-moving=true][data-source=mesh][data-shown='{pinned['revision']}']")
        drawn_here = pinned.look()
        assert near(drawn_here.centre("red"), (150, 140), 2.5)
        pinned.page.mouse.up()
        pinned.body("[data-moving=false][data-source=mesh][data-state=busy]")
    pinned.ready()
    seen = pinned.look()
    for name, place in (("red", (150, 140)), ("green", GREEN), ("blue", BLUE)):
        assert near(seen.centre(name), place, 2.5), name
    # Both draw the same warp: edges differ, nothing else does.
    assert 0 < seen.differs(drawn_here) < 0.02 * seen.image.width * seen.image.height


def test_what_rests_on_the_screen_is_the_servers_picture(pinned):
    """At 100 % the screen shows the bytes of the download, pixel by pixel."""
    pinned.drag(RED, (160, 130))
    pinned.ready()
    pinned.page.click("#pin-border")
    pinned.page.click("#zoom-full")
    data = pinned.ready()
    assert float(data["zoom"]) == 1
    png = pinned.saved("download")[1]
    assert png == pinned.of_server().body
    bent = Image.open(io.BytesIO(png)).convert("RGBA")
    look = pinned.look()
    assert look.image.size == bent.size
    # The board under it is seen through what is transparent.
    solid = bent.getchannel("A").point(lambda a: 255 * (a == 255))
    apart = ImageChops.difference(look.image, bent.convert("RGB")).split()
    worst = ImageChops.lighter(ImageChops.lighter(apart[0], apart[1]), apart[2]).histogram(solid)
    assert sum(worst) > 0.8 * bent.width * bent.height
    # A stage of odd width lays the picture half a pixel aside: then its edges are a little softer.
    assert sum(worst[:3]) > 0.97 * sum(worst)


def test_one_drag_is_one_step_of_undo(pinned):
    assert steps(pinned) == (3, 0)
    pinned.drag(RED, (120, 130), (140, 110), (150, 140), steps=8)
    pinned.ready()
    assert steps(pinned) == (4, 0)
    bent = pinned.saved("download")[1]
    pinned.page.click("#undo")
    pinned.ready()
    assert steps(pinned) == (3, 1)
    assert near(pinned.posed(0), RED, 0.5) and near(pinned.look().centre("red"), RED, 1.5)
    pinned.page.click("#redo")
    pinned.ready()
    assert steps(pinned) == (4, 0)
    assert pinned.saved("download")[1] == bent
    for _ in range(4):
        pinned.page.click("#undo")
    assert pinned.body("[data-handles='0']").page.locator("#undo").is_disabled()
    pinned.keys("Control+Shift+z")
    pinned.body("[data-handles='1']")


def test_a_click_that_trembles_is_no_drag(pinned):
    pinned.press(RED)
    x, y = pinned.at(*RED)
    pinned.page.mouse.move(x + 1, y + 1)
    pinned.page.mouse.up()
    assert pinned["selected"] == "1" and steps(pinned) == (3, 0)


def test_a_grip_a_little_off_the_dot_holds_it_and_keeps_its_distance(pinned):
    x, y = pinned.at(*RED)
    mouse = pinned.page.mouse
    mouse.move(x + 10, y)
    mouse.down()
    mouse.move(x + 50, y + 20, steps=3)
    mouse.up()
    pinned.ready()
    zoom = float(pinned["zoom"])
    assert near(pinned.posed(0), (RED[0] + 40 / zoom, RED[1] + 20 / zoom), 0.6)


def test_escape_gives_a_drag_up(pinned):
    pinned.press(RED, (180, 150))
    pinned.keys("Escape")
    pinned.page.mouse.up()
    pinned.ready()
    assert steps(pinned) == (3, 0) and near(pinned.posed(0), RED, 0.5)


def test_a_handle_is_deleted_and_put_back(pinned):
    pinned.drag(RED, (150, 140))
    pinned.drag(GREEN, (300, 120))
    pinned.ready()
    pinned.click(150, 140)
    assert (pinned["selected"], pinned.text("selection-count")) == ("1", "Point 1")
    pinned.page.click("#put-back")
    pinned.ready()
    assert near(pinned.posed(0), RED, 0.5) and near(pinned.posed(1), (300, 120), 0.5)
    assert near(pinned.look().centre("red"), RED, 1.5)
    pinned.click(300, 120)
    pinned.page.click("#remove")
    assert pinned.body("[data-handles='2']").ready()["selected"] == "0"
    assert not pinned.page.locator("#selection").is_visible()
    # Two that rest: nothing is bent any more.
    for name, place in (("red", RED), ("green", GREEN), ("blue", BLUE)):
        assert near(pinned.look().centre(name), place, 1), name


def test_a_click_chooses_one_and_shift_more(pinned):
    pinned.click(*RED)
    assert pinned.page.locator("[aria-pressed=true][data-handle]").get_attribute("id") == "handle-0"
    pinned.page.keyboard.down("Shift")
    pinned.click(*GREEN)
    pinned.click(*BLUE)
    assert pinned["selected"] == "3"
    pinned.click(*RED)
    pinned.page.keyboard.up("Shift")
    assert pinned["selected"] == "2" and pinned.text("selection-count") == "2 selected"
    pinned.click(*RED)
    assert pinned["selected"] == "1"


def test_a_group_moves_together(pinned):
    pinned.drag((60, 60), (360, 140))  # a rectangle on nothing: red and green are in it
    assert (pinned["selected"], pinned["handles"]) == ("2", "3")
    pinned.drag(RED, (RED[0] + 20, RED[1] + 40))
    pinned.ready()
    assert steps(pinned) == (4, 0)
    for handle, (x, y), (dx, dy) in ((0, RED, (20, 40)), (1, GREEN, (20, 40)), (2, BLUE, (0, 0))):
        assert near(pinned.posed(handle), (x + dx, y + dy), 0.6), handle
    look = pinned.look()
    assert near(look.centre("red"), (120, 140), 1.5) and near(look.centre("green"), (340, 130), 1.5)


def turned(place, centre, degrees):
    x, y = place[0] - centre[0], place[1] - centre[1]
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return centre[0] + x * cos - y * sin, centre[1] + x * sin + y * cos


def test_a_group_is_turned_by_the_ring_and_by_the_buttons(pinned):
    pinned.page.click("#select-all")
    centre = ((RED[0] + GREEN[0]) / 2, (GREEN[1] + BLUE[1]) / 2)
    knob = pinned.page.locator("#ring-knob").bounding_box()
    spot = (knob["x"] + knob["width"] / 2, knob["y"] + knob["height"] / 2)
    goal = turned(spot, pinned.at(*centre), 30)
    mouse = pinned.page.mouse
    mouse.move(*spot)
    mouse.down()
    mouse.move(*goal, steps=6)
    mouse.up()
    pinned.ready()
    assert steps(pinned) == (4, 0)
    for handle, place in enumerate((RED, GREEN, BLUE)):
        assert near(pinned.posed(handle), turned(place, centre, 30), 1), handle
    assert near(pinned.look().centre("green"), turned(GREEN, centre, 30), 1.5)
    # The buttons turn about the middle of what is selected now.
    posed = [pinned.posed(k) for k in range(3)]
    middle = tuple((min(c) + max(c)) / 2 for c in zip(*posed))
    pinned.page.click("#rotate-left")
    pinned.ready()
    for handle, place in enumerate(posed):
        assert near(pinned.posed(handle), turned(place, middle, -5), 0.1), handle
    pinned.page.click("#rotate-right")
    pinned.ready()


def test_select_more_and_move_to_need_no_drag(pinned):
    """Whatever a drag does, clicks do (WCAG 2.5.7)."""
    pinned.click(*RED)
    pinned.page.click("#select-more")
    pinned.click(*GREEN)
    assert pinned["selected"] == "2"
    pinned.page.click("#move-to")
    assert pinned["arm"] == "move"
    pinned.click(230, 135)  # where the middle of the two goes, from (210, 95)
    pinned.ready()
    assert pinned["arm"] == ""
    assert near(pinned.posed(0), (120, 140), 0.6) and near(pinned.posed(1), (340, 130), 0.6)
    assert near(pinned.look().centre("red"), (120, 140), 1.5)


def test_a_line_by_one_drag_and_by_two_clicks(opened):
    opened.page.click("label:has(#tool-line)")
    opened.drag((60, 40), (340, 40))
    opened.body("[data-handles='1'][data-draft='0']")
    opened.click(60, 260)
    opened.body("[data-draft='1']")
    opened.click(340, 260)
    opened.body("[data-handles='2'][data-draft='0']").ready()
    for handle, y in ((0, 40), (1, 260)):
        assert opened.page.locator(f"#handle-{handle}").get_attribute("data-kind") == "line"
        assert near(opened.posed(handle, 0), (60, y), 0.5) and near(
            opened.posed(handle, 1), (340, y), 0.5
        )
    # Taken between its places it moves as a whole, taken at one it turns.
    opened.drag((200, 40), (200, 70))
    assert near(opened.posed(0, 0), (60, 70), 0.5) and near(opened.posed(0, 1), (340, 70), 0.5)
    opened.drag((340, 260), (330, 240))
    opened.ready()
    assert near(opened.posed(1, 0), (60, 260), 0.5) and near(opened.posed(1, 1), (330, 240), 0.5)
    warp = opened.warp()
    assert [len(line) for line in warp["p"]] == [2, 2]
    assert opened.saved("download")[1] == opened.of_server().body


def test_a_path_ends_by_a_double_click_or_by_its_button(opened):
    opened.page.click("label:has(#tool-path)")
    for place in ((60, 60), (150, 90)):
        opened.click(*place)
    opened.page.mouse.dblclick(*opened.at(260, 60))
    opened.body("[data-handles='1'][data-draft='0']")
    assert opened.page.locator("#handle-0").get_attribute("data-kind") == "path"
    assert opened.page.locator("#handle-0 ~ [data-handle='0'][data-vertex]").count() == 3
    for place in ((60, 240), (150, 210), (260, 240), (330, 200)):
        opened.click(*place)
    assert opened.text("draft-text") == "Path: 4 points"
    opened.page.click("#draft-finish")
    opened.body("[data-handles='2'][data-draft='0']").ready()
    assert [len(path) for path in opened.warp()["p"]] == [3, 4]
    opened.click(60, 150)
    opened.page.click("#draft-cancel")
    opened.body("[data-handles='2'][data-draft='0']")
    # A place of a path is deleted alone, and the path by its whole.
    opened.click(*opened.posed(1, 1))
    opened.page.click("#remove")
    opened.ready()
    assert [len(path) for path in opened.warp()["p"]] == [3, 3]


def test_the_border_is_pinned(opened):
    opened.click(*RED)
    opened.page.click("#pin-border")
    opened.body("[data-handles='2']")
    opened.drag(RED, (150, 130))
    opened.ready()
    assert near(opened.look().centre("red"), (150, 130), 1.5)
    corners = opened.server.ask(
        "POST",
        "/points",
        {
            **opened.warp(),
            "extent": [400, 300],
            "points": [[0, 0], [400, 0], [400, 300], [0, 300], [200, 0]],
        },
    )
    for seen, rest in zip(
        json.loads(corners.body)["points"], ((0, 0), (400, 0), (400, 300), (0, 300), (200, 0))
    ):
        assert near(seen, rest, 0.01)


def test_the_wheel_zooms_at_the_cursor(pinned):
    before = float(pinned["zoom"])
    spot = pinned.at(*GREEN)
    pinned.page.mouse.move(*spot)
    pinned.page.mouse.wheel(0, -240)
    pinned.body(f":not([data-zoom='{before}'])")
    assert float(pinned["zoom"]) > 1.3 * before
    assert near(pinned.at(*GREEN), spot, 0.5)
    assert near(pinned.look().centre("green"), GREEN, 1)
    pinned.page.mouse.wheel(0, 240)
    pinned.body(f"[data-zoom^='{str(before)[:6]}']")
    assert pinned["handles"] == "3"


def test_the_zoom_buttons(pinned):
    page, fit = pinned.page, float(pinned["zoom"])
    page.click("#zoom-in")
    assert float(pinned["zoom"]) > fit
    page.click("#zoom-out")
    page.click("#zoom-out")
    assert float(pinned["zoom"]) < fit
    page.click("#zoom-full")
    assert float(pinned["zoom"]) == 1 and pinned.text("zoom-value") == "100 %"
    page.click("#zoom-fit")
    assert float(pinned["zoom"]) == fit
    # A handle put at another zoom lies where the click was.
    page.click("#zoom-full")
    pinned.click(250, 150)
    assert near(pinned.posed(3), (250, 150), 0.6)


def pan_of(visit):
    return [float(c) for c in visit["pan"].split(",")]


def test_the_view_is_moved_by_space_by_the_middle_button_and_by_buttons(pinned):
    page = pinned.page
    page.mouse.move(*pinned.at(200, 150))
    page.mouse.wheel(0, -600)
    pinned.page.wait_for_selector("#pan-right")
    start = pan_of(pinned)
    spot = pinned.at(200, 150)
    page.keyboard.down("Space")
    page.mouse.move(*spot)
    page.mouse.down()
    page.mouse.move(spot[0] + 60, spot[1] - 30, steps=4)
    page.mouse.up()
    page.keyboard.up("Space")
    assert near(pan_of(pinned), (start[0] + 60, start[1] - 30), 0.1)
    page.mouse.move(*spot)
    page.mouse.down(button="middle")
    page.mouse.move(spot[0] - 60, spot[1] + 30, steps=4)
    page.mouse.up(button="middle")
    assert near(pan_of(pinned), start, 0.1)
    page.click("#pan-right")
    assert pan_of(pinned)[0] < start[0]
    page.click("#pan-left")
    page.click("#pan-down")
    assert pan_of(pinned)[1] < start[1]
    page.click("#pan-up")
    assert near(pan_of(pinned), start, 1.1)
    assert (pinned["handles"], pinned["undo"], pinned["state"]) == ("3", "3", "ready")


def test_the_right_button_does_nothing_to_the_handles(pinned):
    pinned.click(250, 150, button="right")
    assert (pinned["handles"], pinned["undo"]) == ("3", "3")
