"""Strength of the pose, magnifier, numbers of handles, focus that stays, and the table."""

import json
import math

import pytest

from support import BLUE, GREEN, RED, Fingers, near

PHONE = {
    "viewport": {"width": 390, "height": 780},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}
POSED = {0: (120, 110), 1: (300, 100), 2: (220, 240)}


def pin(visit):
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.body("[data-handles='3']").ready()
    return visit


def type_pose(visit):
    for handle, place in POSED.items():
        for axis, number in zip("xy", place):
            visit.page.fill(f"#q-{handle}-0-{axis}", str(number))
            visit.page.keyboard.press("Enter")
    visit.ready()


@pytest.fixture
def bent(opened):
    pin(opened)
    type_pose(opened)
    return opened


def at(rest, posed, t):
    return tuple(p + t * (q - p) for p, q in zip(rest, posed))


def shown_at(visit, t):
    for handle, rest in enumerate((RED, GREEN, BLUE)):
        assert near(visit.posed(handle), at(rest, POSED[handle], t), 0.02), (handle, t)


# Strength


def test_strength_slides_from_rest_to_pose_and_beyond_both(bent):
    slider = bent.page.locator("#strength")
    undo = int(bent["undo"])
    for t in (0, 0.5, 2, -1):
        slider.fill(str(t))
        data = bent.ready()
        assert data["strength"] == str(t)
        shown_at(bent, t)
    assert bent.text("strength-value") == "-100 %"
    slider.fill("1")
    bent.ready()
    shown_at(bent, 1)
    assert int(bent["undo"]) > undo
    bent.keys("Control+z")
    bent.ready()
    assert bent["strength"] != "1" or int(bent["undo"]) == undo


def test_sliding_by_mouse_is_live_and_one_step(bent):
    undo = int(bent["undo"])
    slider, mouse = bent.page.locator("#strength"), bent.page.mouse
    box = slider.bounding_box()
    # Waits until the slider stays where it is and nothing covers it.
    slider.hover(position={"x": 8 + (box["width"] - 16) * 2 / 3, "y": box["height"] / 2})
    box = slider.bounding_box()
    x, y = box["x"] + 8 + (box["width"] - 16) * 2 / 3, box["y"] + box["height"] / 2
    mouse.down()
    mouse.move(x - (box["width"] - 16) / 6, y, steps=5)
    bent.body(f"[data-moving=true][data-source=mesh][data-shown='{bent['revision']}']")
    mouse.move(x - (box["width"] - 16) / 3, y, steps=5)
    mouse.up()
    data = bent.ready()
    assert data["strength"] == "0", "the rest pose attracts the slider"
    assert int(data["undo"]) == undo + 1
    shown_at(bent, 0)
    bent.page.focus("#stage")
    bent.keys("Control+z")
    assert bent.ready()["strength"] == "1"
    shown_at(bent, 1)


def test_exports_have_the_shown_strength(bent):
    bent.page.locator("#strength").fill("0.5")
    bent.ready()
    for handle, place in enumerate(bent.warp()["q"]):
        assert near(place, at((RED, GREEN, BLUE)[handle], POSED[handle], 0.5), 0.02)
    assert bent.saved("download")[1] == bent.of_server().body
    line = bent.copied("copy-curl")
    assert json.dumps(bent.warp()["q"]).replace(" ", "") in line
    bent.page.reload()
    assert bent.ready()["strength"] == "0.5"
    bent.page.locator("#strength").fill("1")
    bent.ready()
    shown_at(bent, 1)


def test_an_edit_makes_the_shown_pose_the_new_one(bent):
    bent.page.locator("#strength").fill("0.5")
    bent.ready()
    half = [bent.posed(k) for k in range(3)]
    bent.drag(half[2], (200, 200))
    assert bent.ready()["strength"] == "1"
    assert near(bent.posed(0), half[0], 0.01) and near(bent.posed(2), (200, 200), 1)
    bent.keys("Control+z")
    assert bent.ready()["strength"] == "0.5"
    bent.page.locator("#strength").fill("1")
    bent.ready()
    shown_at(bent, 1)


def test_a_twist_has_the_strength_too(bent):
    bent.page.fill("#twist-0", "40")
    bent.page.keyboard.press("Enter")
    bent.ready()
    bent.page.locator("#strength").fill("0.5")
    bent.ready()
    assert bent.page.input_value("#twist-0") == "20"
    bent.page.locator("#strength").fill("1")
    bent.ready()
    assert bent.page.input_value("#twist-0") == "40"


# The magnifier


@pytest.fixture
def phone(visits, picture):
    visit = visits(**PHONE).open(picture)
    fingers = Fingers(visit)
    for place in (RED, GREEN, BLUE):
        fingers.tap(*visit.at(*place))
    visit.body("[data-handles='3']").ready()
    return visit


def loupe(visit):
    return visit.page.locator("#loupe")


COLOUR = """(node) => { const { width } = node; const side = 9;
  const [x, y] = [width / 2 + width / 7, width / 2 - width / 7];
  return [...node.getContext("2d").getImageData(x, y, 1, 1).data]; }"""


def test_a_finger_that_drags_has_a_magnifier_above_it(phone):
    fingers = Fingers(phone)
    assert not loupe(phone).is_visible()
    spot = phone.at(*BLUE)
    fingers.put(a=spot)
    goal = phone.at(BLUE[0] - 20, BLUE[1] - 10)
    fingers.move(a=goal)
    phone.body(f"[data-moving=true][data-shown='{phone['revision']}']")
    box = loupe(phone).bounding_box()
    assert box["y"] + box["height"] < goal[1] - 20, "it is above the finger"
    red, green, blue, alpha = loupe(phone).evaluate(COLOUR)
    assert alpha == 255 and blue > 150 and red < 90, "it shows the disc under the finger"
    phone.keep("magnifier")
    # Near the upper edge it moves to the side.
    high = (goal[0], phone.page.locator("#stage").bounding_box()["y"] + 60)
    fingers.move(a=high)
    box = loupe(phone).bounding_box()
    assert box["x"] > high[0] + 20 or box["x"] + box["width"] < high[0] - 20
    fingers.lift()
    phone.ready()
    assert not loupe(phone).is_visible()


def test_the_magnifier_can_be_turned_off_and_is_not_for_the_mouse(phone):
    phone.drag(BLUE, (210, 200))
    phone.press((210, 200), BLUE)
    assert not loupe(phone).is_visible()
    phone.page.mouse.up()
    phone.page.click("#help-open")
    phone.page.uncheck("#loupe-wanted")
    phone.page.click("#help-close")
    phone.page.reload()
    phone.ready()
    fingers = Fingers(phone)
    fingers.put(a=phone.at(*RED))
    fingers.move(a=phone.at(RED[0] + 40, RED[1] + 40))
    assert phone["moving"] == "true" and not loupe(phone).is_visible()
    fingers.lift()


# Numbers


NUMBERS = (
    "[...document.querySelectorAll('#handles text.number')].filter((n) => n.checkVisibility())"
)


def numbers(visit):
    return visit.page.evaluate(f"{NUMBERS}.map((n) => n.textContent)")


def many(visit, side):
    """Opens the picture with a lattice of handles, from a link."""
    places = [
        [12 + 376 * i / (side - 1), 12 + 276 * j / (side - 1)]
        for j in range(side)
        for i in range(side)
    ]
    places = [[round(x, 2), round(y, 2)] for x, y in places]
    link = visit.page.evaluate(
        """([session, warp]) => {
          const members = { session, warp: btoa(JSON.stringify(warp)), name: "many.png" };
          return `#${new URLSearchParams(members)}`;
        }""",
        [visit["session"], {"p": places, "q": places}],
    )
    visit.page.goto(f"{visit.server.address}/{link}")
    visit.body(f"[data-handles='{side * side}']").ready()


def test_numbers_of_many_handles_leave_room_for_the_picture(opened):
    many(opened, 17)
    opened.page.click("#select-all")
    few = numbers(opened)
    assert 0 < len(few) < 200
    overlaps = opened.page.evaluate(f"""() => {{
      const boxes = {NUMBERS}.map((n) => n.getBoundingClientRect());
      const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 &&
        a.top < b.bottom - 3 && b.top < a.bottom - 3;
      return boxes.filter((a, i) => boxes.some((b, j) => i < j && meet(a, b))).length;
    }}""")
    assert overlaps == 0
    opened.keep("numbers")
    opened.page.click("#zoom-in")
    opened.page.click("#zoom-in")
    opened.page.click("#zoom-in")
    assert len(numbers(opened)) > len(few), "a closer view has room for more"
    # The focused one always has its number.
    hidden = opened.page.evaluate("document.querySelector('#handles .crowded')?.id ?? null")
    if hidden:
        opened.page.locator(f"#{hidden}").focus()
        opened.keys("Shift+Tab", "Tab")
        number = str(int(hidden.removeprefix("handle-")) + 1)
        assert number in numbers(opened)


def test_numbers_do_not_change_during_a_drag(opened):
    many(opened, 17)
    opened.page.click("#select-all")
    before = sorted(numbers(opened))
    opened.press((12, 12), (60, 80))
    assert sorted(n for n in numbers(opened) if n != "1") == [n for n in before if n != "1"]
    opened.page.mouse.up()


# Focus, table, knob


def test_a_line_does_not_change_the_focus_of_a_posed_picture(bent):
    assert bent.text("alpha-value") == "1"
    bent.page.click("label:has(#tool-line)")
    bent.click(40, 40)
    bent.click(40, 260)
    bent.body("[data-handles='4']").ready()
    assert bent.text("alpha-value") == "1" and not bent.page.locator("#alpha-auto").is_checked()
    assert "Focus stays at 1" in bent.text("says") and "Automatic would be 2" in bent.text(
        "alpha-note"
    )
    bent.keys("Control+z")
    assert bent.ready()["handles"] == "3" and bent.page.locator("#alpha-auto").is_checked()


def test_at_rest_the_focus_follows_the_handles(opened):
    pin(opened)
    opened.page.click("label:has(#tool-line)")
    opened.click(40, 40)
    opened.click(40, 260)
    opened.body("[data-handles='4']").ready()
    assert opened.text("alpha-value") == "2" and opened.page.locator("#alpha-auto").is_checked()


def test_cells_are_short_and_complete_with_the_focus(opened):
    pin(opened)
    opened.page.fill("#q-0-0-x", "123.46")
    opened.page.keyboard.press("Enter")
    opened.ready()
    assert opened.page.input_value("#q-0-0-x") == "123.46"
    opened.page.focus("#stage")
    assert opened.page.input_value("#q-0-0-x") == "123.5"
    cut = (
        "[...document.querySelectorAll('#handle-table input')].filter((n) => n.scrollWidth > "
        "n.clientWidth).length"
    )
    opened.page.fill("#q-1-0-x", "-1484.93")
    opened.page.keyboard.press("Enter")
    opened.page.focus("#stage")
    assert opened.page.evaluate(cut) == 0
    opened.page.focus("#q-0-0-x")
    assert opened.page.input_value("#q-0-0-x") == "123.46"
    revision = opened["revision"]
    opened.page.focus("#stage")
    assert opened["revision"] == revision, "looking changes nothing"


def test_the_knob_does_not_look_like_a_handle(opened):
    pin(opened)
    assert opened.page.locator("#ring-knob .dot").count() == 0
    box = opened.page.locator("#ring-knob .plate").bounding_box()
    pin_box = opened.page.locator("#handle-2 .dot").bounding_box()
    away = math.dist((box["x"], box["y"]), (pin_box["x"], pin_box["y"]))
    assert away > 30
    opened.keep("pin-ring")
