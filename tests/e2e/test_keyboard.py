"""Everything by keys alone: no test here touches the mouse. The file itself comes through the
browser's chooser."""

import json

import pytest

from support import BLUE, GREEN, RED, near


def focused(visit):
    return visit.page.evaluate("document.activeElement.id")


def tab_to(visit, id, back=False):
    """As far as Tab goes to a control; a control that it does not reach fails."""
    been = []
    for _ in range(150):
        if focused(visit) == id:
            return
        visit.keys("Shift+Tab" if back else "Tab")
        been.append(focused(visit))
    raise AssertionError(f"Tab does not reach {id}, but {been}")


def cross_to(visit, place):
    """Moves the cross from the stage's middle to a place: ten at a time, and one at a time with
    Shift."""
    visit.keys("ArrowRight", "ArrowLeft")
    x, y = visit.page.evaluate(
        "document.querySelector('#says').textContent.split(', ').map(Number)"
    )
    for apart, less, more in (
        (place[0] - x, "ArrowLeft", "ArrowRight"),
        (place[1] - y, "ArrowUp", "ArrowDown"),
    ):
        key = more if apart > 0 else less
        visit.keys(*[key] * int(abs(apart) // 10), *[f"Shift+{key}"] * round(abs(apart) % 10))


def put(visit, *places):
    for place in places:
        tab_to(visit, "stage", back=True)
        visit.keys("Escape", "Escape")
        cross_to(visit, place)
        visit.keys("Enter")


@pytest.fixture
def opened(visit, picture):
    with visit.page.expect_file_chooser() as chooser:
        tab_to(visit, "pick")
        visit.keys("Enter")
    chooser.value.set_files(picture)
    visit.body("[data-state=ready]")
    return visit


@pytest.fixture
def pinned(opened):
    put(opened, RED, GREEN, BLUE)
    opened.body("[data-handles='3']").ready()
    return opened


def test_a_sample_is_opened_and_the_focus_is_on_the_picture(visit):
    tab_to(visit, "sample-rocket")
    visit.keys("Space")
    assert int(visit.ready()["handles"]) > 2
    assert focused(visit) == "stage"
    visit.keys("2", "ArrowRight", "Enter")
    assert (visit["tool"], visit["draft"]) == ("line", "1")


def test_characters_work_with_the_focus_on_a_button(pinned):
    tab_to(pinned, "theme", back=True)
    pinned.keys("2", "g")
    assert (
        pinned["tool"] == "line"
        and pinned.page.locator("#mesh").get_attribute("aria-pressed") == "true"
    )
    # Keys that the button or a field uses itself keep their meaning.
    pinned.keys("Enter", "ArrowDown", "Delete")
    assert (pinned["theme"], pinned["handles"], pinned["undo"]) == ("light", "3", "3")
    tab_to(pinned, "q-0-0-x")
    pinned.keys("3", "e")
    assert pinned["tool"] == "line" and not pinned.page.locator("#export").is_visible()


def test_another_picture_is_opened_by_its_key(opened, picture):
    first, choosers = opened["session"], []
    opened.page.on("filechooser", lambda chooser: choosers.append(chooser))
    # On a busy machine, Chromium sometimes drops the first key.
    for _ in range(3):
        if not choosers:
            opened.keys("Control+o")
            opened.page.wait_for_timeout(2000)
    choosers[0].set_files(picture)
    opened.body(f"[data-state=ready]:not([data-session='{first}'])")


def test_handles_are_put_at_the_cross_and_moved_by_arrows(opened):
    put(opened, RED)
    opened.body("[data-handles='1']").ready()
    assert near(opened.posed(0), RED, 0.01)
    assert focused(opened) == "handle-0" and opened["selected"] == "1"
    put(opened, GREEN, BLUE)
    tab_to(opened, "handle-0", back=True)
    opened.keys("Enter", *["Shift+ArrowRight"] * 4, *["ArrowDown"] * 3)
    opened.ready()
    assert near(opened.posed(0), (RED[0] + 40, RED[1] + 3), 0.01)
    assert near(opened.look().centre("red"), (140, 103), 1.5)
    assert opened.text("says") == "Point 1 at 140, 103"


def test_arrows_in_quick_succession_are_one_step(pinned):
    before = int(pinned["undo"])
    tab_to(pinned, "handle-1", back=True)
    # Together, so that no slow machine takes them apart.
    pinned.page.evaluate(
        """() => {
          const up = { key: "ArrowUp", bubbles: true, cancelable: true };
          for (let k = 0; k < 12; k++)
            document.activeElement.dispatchEvent(new KeyboardEvent("keydown", up));
        }"""
    )
    pinned.ready()
    assert int(pinned["undo"]) == before + 1 and near(
        pinned.posed(1), (GREEN[0], GREEN[1] - 12), 0.01
    )
    pinned.keys("Control+z")
    pinned.ready()
    assert near(pinned.posed(1), GREEN, 0.01)
    pinned.keys("Control+Shift+z")
    pinned.ready()
    pinned.keys("Control+z", "Control+y")
    pinned.ready()
    assert near(pinned.posed(1), (GREEN[0], GREEN[1] - 12), 0.01)


def test_tab_goes_through_the_handles_in_order(pinned):
    tab_to(pinned, "stage", back=True)
    order = []
    for _ in range(3):
        pinned.keys("Tab")
        order.append(focused(pinned))
    assert order == ["handle-0", "handle-1", "handle-2"]
    names = [pinned.page.locator(f"#{id}").get_attribute("aria-label") for id in order]
    assert names == ["Point 1 at 100, 100", "Point 2 at 320, 90", "Point 3 at 200, 220"]


def test_several_are_chosen_moved_turned_put_back_and_deleted(pinned):
    tab_to(pinned, "handle-0", back=True)
    pinned.keys("Enter", "Tab", "Shift+Enter")
    assert pinned["selected"] == "2"
    pinned.keys("Shift+ArrowDown")
    pinned.ready()
    assert near(pinned.posed(0), (100, 110), 0.01) and near(pinned.posed(1), (320, 100), 0.01)
    pinned.keys("]", "]", "[")
    pinned.ready()
    (ax, ay), (bx, by) = pinned.posed(0), pinned.posed(1)
    # Five degrees clockwise of (-220, 10): about their middle, distances kept.
    assert near(((ax + bx) / 2, (ay + by) / 2), (210, 105), 0.02) and ay < by
    tab_to(pinned, "ring-knob")
    pinned.keys(*["ArrowLeft"] * 5)
    pinned.ready()
    assert near(pinned.posed(0), (100, 110), 0.1) and near(pinned.posed(1), (320, 100), 0.1)
    tab_to(pinned, "handle-1", back=True)
    pinned.keys("r")
    pinned.ready()
    assert near(pinned.posed(0), RED, 0.01) and near(pinned.posed(1), GREEN, 0.01)
    pinned.keys("Delete")
    assert pinned.body("[data-handles='1']").ready()["selected"] == "0"
    pinned.keys("Control+z")
    pinned.body("[data-handles='3']").ready()
    pinned.keys("Control+a")
    assert pinned["selected"] == "3"
    pinned.keys("Escape")
    assert pinned["selected"] == "0"


def test_move_to_by_keys(pinned):
    tab_to(pinned, "handle-0", back=True)
    pinned.keys("Enter", "m")
    assert pinned["arm"] == "move"
    cross_to(pinned, (150, 160))
    pinned.keys("Enter")
    pinned.ready()
    assert pinned["arm"] == "" and near(pinned.posed(0), (150, 160), 0.01)
    assert near(pinned.look().centre("red"), (150, 160), 2.5)


def test_lines_and_paths(opened):
    tab_to(opened, "stage")
    opened.keys("2")
    assert opened["tool"] == "line"
    cross_to(opened, (60, 60))
    opened.keys("Enter", *["ArrowRight"] * 20, "Enter")
    opened.body("[data-handles='1'][data-draft='0']")
    tab_to(opened, "stage", back=True)
    opened.keys("Escape", "Escape", "3")
    cross_to(opened, (60, 240))
    opened.keys(
        "Enter",
        *["ArrowRight"] * 10,
        *["ArrowUp"] * 3,
        "Enter",
        *["ArrowRight"] * 10,
        "Enter",
        "Enter",
    )
    opened.body("[data-handles='2'][data-draft='0']").ready()
    assert opened.warp()["p"] == [[[60, 60], [260, 60]], [[60, 240], [160, 210], [260, 210]]]
    # A whole line, and one place of a path.
    tab_to(opened, "handle-0", back=True)
    opened.keys("Shift+ArrowDown")
    tab_to(opened, "handle-1-1")
    opened.keys("Shift+ArrowUp")
    opened.ready()
    assert opened.warp()["q"] == [[[60, 70], [260, 70]], [[60, 240], [160, 200], [260, 210]]]


def test_a_drawing_is_given_up(opened):
    tab_to(opened, "stage")
    opened.keys("3", "ArrowRight", "Enter", "ArrowRight", "Enter")
    assert opened["draft"] == "2"
    opened.keys("Escape")
    assert (opened["draft"], opened["handles"]) == ("0", "0")


def test_zoom_and_view(pinned):
    tab_to(pinned, "stage", back=True)
    fit = float(pinned["zoom"])
    pinned.keys("+")
    larger = float(pinned["zoom"])
    assert larger > fit
    pinned.keys("-", "-")
    assert float(pinned["zoom"]) < fit
    pinned.keys("0")
    assert float(pinned["zoom"]) == 1
    pinned.keys("f")
    assert float(pinned["zoom"]) == fit
    pinned.keys("+", "+", "+")
    x, y = (float(c) for c in pinned["pan"].split(","))
    pinned.keys("Alt+ArrowRight", "Alt+ArrowDown")
    assert [float(c) for c in pinned["pan"].split(",")] == pytest.approx([x - 40, y - 40], abs=0.1)
    # A handle outside comes into sight when it has the focus.
    pinned.keys(*["+"] * 6)
    tab_to(pinned, "handle-1")
    box, spot = pinned.page.locator("#stage").bounding_box(), pinned.at(*GREEN)
    assert (
        box["x"] <= spot[0] <= box["x"] + box["width"]
        and box["y"] <= spot[1] <= box["y"] + box["height"]
    )
    assert pinned["undo"] == "3"


def test_mesh_comparison_and_the_original(pinned):
    tab_to(pinned, "handle-0", back=True)
    pinned.keys(*["Shift+ArrowRight"] * 4)
    pinned.ready()
    bent = pinned.look()
    pinned.keys("g")
    assert pinned.page.locator("#mesh").get_attribute("aria-pressed") == "true"
    assert pinned.look().differs(bent) > 2000
    pinned.keys("g")
    assert pinned.look().differs(bent) == 0
    pinned.page.keyboard.down("b")
    assert near(pinned.look().centre("red"), RED, 1)
    pinned.page.keyboard.up("b")
    assert pinned.look().differs(bent) == 0
    pinned.keys("c")
    assert pinned.page.locator("#compare").get_attribute("aria-pressed") == "true"
    tab_to(pinned, "compare-at")
    pinned.keys("End")
    assert near(pinned.look().centre("red"), RED, 1)
    pinned.keys("Home")
    assert near(pinned.look().centre("red"), (140, 100), 1.5)
    tab_to(pinned, "stage", back=True)
    pinned.keys("c")
    assert pinned.page.locator("#compare").get_attribute("aria-pressed") == "false"


def test_the_panel_and_the_table(pinned):
    tab_to(pinned, "method-rigid")
    pinned.keys("ArrowRight")
    assert (
        focused(pinned) == "method-similarity"
        and pinned.page.locator("#method-similarity").is_checked()
    )
    tab_to(pinned, "alpha")
    pinned.keys("ArrowRight", "ArrowRight")
    assert (
        pinned.text("alpha-value") == "1.2" and not pinned.page.locator("#alpha-auto").is_checked()
    )
    tab_to(pinned, "grid-size")
    pinned.keys("ArrowDown")
    tab_to(pinned, "q-0-0-x")
    pinned.keys("Control+a", *"151.5", "Enter")
    pinned.ready()
    warp = pinned.warp()
    assert (warp["method"], warp["alpha"], warp["grid"]) == ("similarity", 1.2, {"cell": 2})
    assert warp["q"][0] == [151.5, 100] and warp["p"][0] == list(RED)
    assert pinned.saved("download")[1] == pinned.of_server().body


def test_what_is_made_is_taken_along(pinned):
    tab_to(pinned, "handle-0", back=True)
    pinned.keys("Shift+ArrowRight")
    pinned.ready()
    with pinned.page.expect_download() as download:
        tab_to(pinned, "download", back=True)
        pinned.keys("Enter")
    assert download.value.suggested_filename == "discs-warped.png"
    with pinned.page.expect_download() as download:
        tab_to(pinned, "save-handles")
        pinned.keys("Enter")
    with open(download.value.path()) as file:
        assert json.load(file)["q"][0] == [110, 100]
    tab_to(pinned, "copy-curl")
    pinned.keys("Space")
    pinned.page.wait_for_selector("#toast.seen")
    assert pinned.page.evaluate("navigator.clipboard.readText()").startswith("curl ")


def test_help_is_one_key_away_and_single_keys_can_be_switched_off(opened):
    tab_to(opened, "stage")
    opened.keys("?")
    help = opened.page.locator("#help")
    assert help.is_visible()
    tab_to(opened, "keys")
    opened.keys("Space", "Escape")
    assert not help.is_visible()
    tab_to(opened, "stage")
    opened.keys("2", "?", "g")
    assert opened["tool"] == "point" and not help.is_visible()
    # What needs no single key still goes.
    tab_to(opened, "help-open", back=True)
    opened.keys("Enter")
    assert help.is_visible()
    tab_to(opened, "help-close")
    opened.keys("Enter")
    assert not help.is_visible() and focused(opened) == "help-open"
