"""The same by fingers, on a phone's screen. Touches come as the screen reports them; the browser
makes pointer events of them."""

import pytest

from support import BLUE, GREEN, RED, Fingers, near

PHONE = {
    "viewport": {"width": 390, "height": 780},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}


@pytest.fixture
def phone(visits, picture):
    return visits(**PHONE).open(picture)


@pytest.fixture
def fingers(phone):
    return Fingers(phone)


@pytest.fixture
def pinned(phone, fingers):
    for place in (RED, GREEN, BLUE):
        fingers.tap(*phone.at(*place))
    phone.body("[data-handles='3']").ready()
    return phone


def test_a_tap_opens_a_sample(visits):
    visit = visits(**PHONE)
    box = visit.page.locator("#sample-cat").bounding_box()
    Fingers(visit).tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert int(visit.ready()["handles"]) > 3


def test_a_tap_adds_a_handle_under_the_finger(phone, fingers):
    fingers.tap(*phone.at(150, 80))
    data = phone.body("[data-handles='1']").ready()
    assert (data["selected"], data["undo"]) == ("1", "1")
    assert near(phone.posed(0), (150, 80), 1)


def test_a_finger_drags_a_handle_and_the_picture_follows(pinned, fingers):
    still = pinned.look()
    fingers.put(a=pinned.at(*RED))
    fingers.move(a=pinned.at(140, 150))
    pinned.body(f"[data-moving=true][data-shown='{pinned['revision']}']")
    followed = pinned.look()
    assert followed.differs(still) > 500 and near(followed.centre("red"), (140, 150), 2)
    fingers.lift()
    data = pinned.ready()
    assert (data["handles"], data["undo"], data["moving"]) == ("3", "4", "false")
    assert near(pinned.posed(0), (140, 150), 1) and near(pinned.look().centre("red"), (140, 150), 2)


def test_a_finger_beside_the_dot_takes_it(pinned, fingers):
    """A target is 44 px across."""
    x, y = pinned.at(*BLUE)
    fingers.put(a=(x + 19, y))
    fingers.move(a=(x + 19, y - 60))
    fingers.lift()
    pinned.ready()
    assert pinned["handles"] == "3"
    assert near(pinned.posed(2), (BLUE[0], BLUE[1] - 60 / float(pinned["zoom"])), 1)


def test_two_fingers_zoom_and_move_the_view_and_nothing_else(pinned, fingers):
    before, poses = pinned.data, [pinned.posed(k) for k in range(3)]
    left, right = pinned.at(150, 150), pinned.at(250, 150)
    held = 200, 150  # what lies between the fingers stays between them
    fingers.put(a=left, b=right)
    fingers.move(a=(left[0] - 60, left[1] + 50), b=(right[0] + 60, right[1] + 50))
    x, y = pinned.at(*held)
    assert near((x, y), ((left[0] + right[0]) / 2, left[1] + 50), 2)
    apart = right[0] - left[0]
    assert abs(float(pinned["zoom"]) / float(before["zoom"]) - (apart + 120) / apart) < 0.05
    fingers.lift("a")
    fingers.move(b=(right[0] + 90, right[1] + 90))  # the finger that stays draws and moves nothing
    fingers.lift("b")
    after = pinned.data
    for name in ("handles", "undo", "revision", "selected"):
        assert after[name] == before[name], name
    assert [pinned.posed(k) for k in range(3)] == poses


def test_a_second_finger_gives_the_drag_up(pinned, fingers):
    undo = pinned["undo"]
    fingers.put(a=pinned.at(*RED))
    fingers.move(a=pinned.at(150, 150))
    assert pinned["moving"] == "true"
    fingers.put(b=pinned.at(300, 250))
    assert pinned["moving"] == "false"
    fingers.move(a=pinned.at(160, 160), b=pinned.at(320, 260))
    fingers.lift()
    pinned.ready()
    assert (pinned["undo"], pinned["handles"]) == (undo, "3") and near(pinned.posed(0), RED, 1)


def test_a_touch_that_the_system_takes_away_leaves_no_drag_behind(pinned, fingers):
    fingers.put(a=pinned.at(*RED))
    fingers.move(a=pinned.at(150, 150))
    fingers.take_away()
    pinned.ready()
    assert pinned["moving"] == "false" and near(pinned.posed(0), RED, 1)
    fingers.put(a=pinned.at(*GREEN))
    fingers.move(a=pinned.at(300, 120))
    fingers.lift()
    pinned.ready()
    assert near(pinned.posed(0), RED, 1) and near(pinned.posed(1), (300, 120), 1)


def test_the_page_does_not_scroll_under_the_finger(pinned, fingers):
    fingers.put(a=pinned.at(*RED))
    fingers.move(a=pinned.at(100, 260))
    fingers.lift()
    pinned.ready()
    assert pinned.page.evaluate(
        "[scrollX, scrollY, document.scrollingElement.scrollTop, visualViewport.scale]"
    ) == [0, 0, 0, 1]
    assert near(pinned.posed(0), (100, 260), 1)


def test_lines_and_paths_by_finger(phone, fingers):
    phone.page.tap("label:has(#tool-line)")
    fingers.put(a=phone.at(60, 60))
    fingers.move(a=phone.at(330, 60))
    fingers.lift()
    phone.body("[data-handles='1'][data-draft='0']")
    phone.page.tap("label:has(#tool-path)")
    for place in ((60, 240), (180, 200), (330, 240)):
        fingers.tap(*phone.at(*place))
    phone.page.tap("#draft-finish")
    phone.body("[data-handles='2'][data-draft='0']").ready()
    kinds = [phone.page.locator(f"#handle-{k}").get_attribute("data-kind") for k in (0, 1)]
    assert kinds == ["line", "path"]
    assert near(phone.posed(0, 1), (330, 60), 1) and near(phone.posed(1, 1), (180, 200), 1)


def test_a_group_by_taps_alone(pinned, fingers):
    tap = pinned.page.tap
    fingers.tap(*pinned.at(*RED))
    tap("#select-more")
    fingers.tap(*pinned.at(*GREEN))
    assert pinned["selected"] == "2"
    tap("#move-to")
    fingers.tap(*pinned.at(210, 155))  # their middle was at (210, 95)
    pinned.ready()
    assert near(pinned.posed(0), (100, 160), 1.5) and near(pinned.posed(1), (320, 150), 1.5)
    tap("#rotate-right")
    pinned.ready()
    assert pinned.posed(0)[1] < 155 < pinned.posed(1)[1]
    tap("#put-back")
    pinned.ready()
    assert near(pinned.posed(0), RED, 1) and near(pinned.posed(1), GREEN, 1)
    tap("#remove")
    assert pinned.body("[data-handles='1']").ready()["selected"] == "0"
    tap("#undo")
    pinned.body("[data-handles='3']").ready()


def test_the_settings_open_over_the_picture(pinned):
    toggle = pinned.page.locator("#panel-toggle")
    assert (
        toggle.get_attribute("aria-expanded") == "false"
        and not pinned.page.locator("#method-affine").is_visible()
    )
    toggle.tap()
    assert toggle.get_attribute("aria-expanded") == "true"
    first = pinned["revision"]
    pinned.page.tap("label:has(#method-affine)")
    assert pinned["revision"] != first
    toggle.tap()
    assert not pinned.page.locator("#method-affine").is_visible()
    pinned.ready()


def test_the_original_is_seen_while_a_finger_holds(pinned, fingers):
    fingers.put(a=pinned.at(*RED))
    fingers.move(a=pinned.at(140, 150))
    fingers.lift()
    pinned.ready()
    box = pinned.page.locator("#before").bounding_box()
    fingers.put(a=(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))
    assert near(pinned.look().centre("red"), RED, 1.5)
    fingers.lift()
    assert near(pinned.look().centre("red"), (140, 150), 2)
