"""Twisting a pin: by mouse, keyboard and table; what the server gets; saving and opening; what else
moves."""

import json
import math

import pytest

from support import BLUE, GREEN, RED, near

POSED = {0: (110, 92), 1: (312, 100), 2: (206, 228)}


@pytest.fixture
def pinned(opened):
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.body("[data-handles='3']").ready()
    return opened


def pose(visit):
    for handle, place in POSED.items():
        for axis, number in zip("xy", place):
            visit.page.fill(f"#q-{handle}-0-{axis}", str(number))
            visit.page.keyboard.press("Enter")
    visit.ready()


def mesh(visit):
    """The vertices of the posed grid, from the server."""
    answer = visit.server.ask(
        "POST", f"/sessions/{visit['session']}/mesh", {"q": visit.warp()["q"]}
    )
    assert answer.status == 200, answer.body
    return json.loads(answer.body)["vertices"]


def largest(a, b):
    """The largest distance of corresponding vertices."""
    assert len(a) == len(b) > 100
    return max(math.dist(m, n) for m, n in zip(a, b))


def choose(visit, handle):
    visit.page.locator(f"#handle-{handle}").focus()
    visit.keys("Enter")
    visit.body("[data-selected='1']")


def knob_at(visit):
    """The middle of the knob and of the pin, CSS px."""
    box = visit.page.locator("#ring-knob .plate").bounding_box()
    return (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def turn(visit, handle, degrees, release=True):
    spot, centre = knob_at(visit), visit.at(*visit.posed(handle))
    mouse = visit.page.mouse
    mouse.move(*spot)
    mouse.down()
    for step in range(1, 7):
        angle = math.radians(degrees * step / 6)
        x, y = spot[0] - centre[0], spot[1] - centre[1]
        mouse.move(
            centre[0] + x * math.cos(angle) - y * math.sin(angle),
            centre[1] + x * math.sin(angle) + y * math.cos(angle),
        )
    if release:
        mouse.up()


def twist(visit, handle):
    words = visit.page.input_value(f"#twist-{handle}")
    return None if words == "" else float(words)


@pytest.mark.parametrize("method", ["rigid", "similarity", "affine"])
def test_the_knob_turns_the_picture_around_the_pin_and_nothing_far_away(pinned, method):
    pinned.page.check(f"#method-{method}", force=True)
    pinned.ready()
    choose(pinned, 0)
    before, undo = mesh(pinned), int(pinned["undo"])
    turn(pinned, 0, 60, release=False)
    pinned.body(f"[data-moving=true][data-shown='{pinned['revision']}']")
    pinned.page.mouse.up()
    data = pinned.ready()
    assert data["handles"] == "3" and int(data["undo"]) == undo + 1
    assert abs(twist(pinned, 0) - 60) <= 1 and near(pinned.posed(0), RED, 0.01)
    after = mesh(pinned)
    moved = [(math.dist(a, RED), math.dist(a, b), a, b) for a, b in zip(before, after)]
    # Close to the pin the picture turns clockwise; at the other pins it rests.
    for _, away, a, _ in moved:
        if math.dist(a, GREEN) < 8 or math.dist(a, BLUE) < 8:
            assert away < 1.5
    angles = []
    for off, _, a, b in moved:
        if 3 < off < 15:
            angle = math.degrees(
                math.atan2(b[1] - RED[1], b[0] - RED[0]) - math.atan2(a[1] - RED[1], a[0] - RED[0])
            )
            angles.append((angle + 180) % 360 - 180)
    assert sum(angles) / len(angles) > 20 and sum(angle > 0 for angle in angles) > 0.7 * len(angles)
    pinned.keys("Control+z")
    pinned.ready()
    assert twist(pinned, 0) is None and largest(before, mesh(pinned)) == 0


def test_a_twist_begins_where_the_other_handles_have_turned_the_pin(pinned):
    """With a posed picture the first degree moves no vertex by more than 0.1 px beyond its own
    turn; without a turn it is a plain pin."""
    pose(pinned)
    choose(pinned, 0)
    plain = mesh(pinned)
    turn(pinned, 0, 40, release=False)
    pinned.page.keyboard.press("Escape")
    pinned.page.mouse.up()
    pinned.ready()
    assert twist(pinned, 0) is None and largest(plain, mesh(pinned)) == 0
    choose(pinned, 0)
    pinned.keys("]")
    pinned.ready()
    free = twist(pinned, 0) - 5
    assert abs(free) > 0.3, "the others turn this pin"
    pinned.keys("Control+z")
    pinned.page.fill("#twist-0", str(round(free + 0.1, 1)))
    pinned.page.keyboard.press("Enter")
    pinned.ready()
    assert len(pinned.warp()["p"][0]) == 2, "it is a segment now"
    assert largest(plain, mesh(pinned)) <= 0.1


def test_the_server_gets_a_segment_of_the_same_weight(pinned):
    choose(pinned, 1)
    pinned.keys("]", "]", "]")
    pinned.ready()
    warp = pinned.warp()
    (a, b), (c, d) = warp["p"][1], warp["q"][1]
    length = b[0] - a[0]
    assert a[1] == b[1] and near(((a[0] + b[0]) / 2, a[1]), GREEN, 0.01)
    assert abs(math.degrees(math.atan2(d[1] - c[1], d[0] - c[0])) - 15) < 0.05
    assert abs(math.dist(c, d) - length) < 0.01
    assert (
        abs(warp["weights"][1] * length - warp["point_mass"]) < 1e-9
        and warp["weights"][0] == warp["weights"][2] == 1
    )
    assert warp["alpha"] == 1 and isinstance(warp["p"][0][0], float | int)
    assert pinned.page.locator("[data-kind=point]").count() == 3, "it is one point to the user"
    assert pinned.page.locator("#handle-table tbody tr").count() == 3


def test_with_a_line_the_other_handles_keep_their_effect(pinned):
    """A set with a line: the point mass is that of the set without the twist."""
    pinned.page.click("label:has(#tool-line)")
    pinned.click(60, 250)
    pinned.click(180, 260)
    pinned.body("[data-handles='4']").ready()
    pose(pinned)
    plain = mesh(pinned)
    choose(pinned, 0)
    pinned.keys("]")
    pinned.ready()
    free = twist(pinned, 0) - 5
    pinned.keys("Control+z")
    pinned.page.fill("#twist-0", str(round(free + 0.1, 1)))
    pinned.page.keyboard.press("Enter")
    pinned.ready()
    warp = pinned.warp()
    assert abs(warp["point_mass"] - math.dist((60, 250), (180, 260))) < 0.5 and warp["alpha"] == 2
    assert warp["weights"][3] == 1
    assert largest(plain, mesh(pinned)) <= 0.1
    pinned.page.fill("#twist-0", "")
    pinned.page.keyboard.press("Enter")
    pinned.ready()
    assert largest(plain, mesh(pinned)) < 1e-6, "the session has the point mass of the lines again"


def test_keys_twist_and_put_back_and_delete(pinned):
    choose(pinned, 2)
    pinned.keys("]", "]", "[")
    assert twist(pinned, 2) == 5 and "twisted to 5 degrees" in pinned.text("says")
    pinned.page.focus("#ring-knob")
    pinned.keys("ArrowRight", "ArrowRight", "Shift+ArrowLeft")
    assert twist(pinned, 2) == -3
    assert "-3 degrees" in pinned.page.get_attribute("#ring-knob", "aria-label")
    pinned.ready()
    pinned.keys("r")
    pinned.ready()
    assert twist(pinned, 2) is None and isinstance(pinned.warp()["p"][2][0], float | int)
    choose(pinned, 2)
    pinned.keys("Control+z", "Delete")
    assert pinned.body("[data-handles='2']").ready()["problem"] == ""


def test_a_pin_that_is_twisted_already_turns_with_a_selection(pinned):
    choose(pinned, 0)
    pinned.keys("]", "]")
    assert twist(pinned, 0) == 10
    pinned.page.click("#select-all")
    pinned.keys("]")
    assert twist(pinned, 0) == 15 and "Rotated by 5 degrees" in pinned.text("says")
    knob, centre = knob_at(pinned), pinned.at(*pinned.posed(1))
    pinned.page.mouse.move(*knob)
    pinned.page.mouse.down()
    pinned.page.mouse.move(*centre, steps=5)
    pinned.page.mouse.up()
    assert twist(pinned, 0) != 15
    assert pinned.ready()["problem"] == ""


def test_saved_pins_are_pins_again(pinned, visits):
    choose(pinned, 1)
    pinned.keys("]", "]", "]", "]")
    pinned.ready()
    saved, link = pinned.warp(), pinned.copied("copy-link")
    other = visits(path=link.split("/", 3)[3].removeprefix("/"))
    other.ready()
    assert other["handles"] == "3" and twist(other, 1) == 20 and twist(other, 0) is None
    again = other.warp()
    assert again["p"][0] == saved["p"][0] and near(again["q"][1][0], saved["q"][1][0], 0.01)
    pinned.page.reload()
    assert pinned.ready()["handles"] == "3" and twist(pinned, 1) == 20
    assert pinned.warp() == saved


def test_a_line_of_the_user_stays_a_line(pinned):
    pinned.page.click("label:has(#tool-line)")
    pinned.click(60, 250)
    pinned.click(180, 250)
    pinned.body("[data-handles='4']").ready()
    choose(pinned, 0)
    pinned.keys("]")
    pinned.ready()
    pinned.page.reload()
    pinned.ready()
    assert pinned.page.locator("[data-kind=line]:not([data-vertex])").count() == 1


def test_a_focus_below_one_half_refuses_with_words(pinned, visits):
    link = pinned.page.evaluate(
        "([session, warp]) => `#${new URLSearchParams({ session, warp: "
        "btoa(JSON.stringify(warp)), name: 'wide.png' })}`",
        [pinned["session"], {"p": [RED, GREEN], "q": [RED, GREEN], "alpha": 0.3}],
    )
    other = visits(path=link)
    other.ready()
    choose(other, 0)
    other.keys("]")
    assert (
        "focus to 0.5" in other.text("says") and twist(other, 0) is None and other["problem"] == ""
    )
