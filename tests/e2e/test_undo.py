"""Undo brings back a picture that was replaced or closed, with its handles and its own steps."""

import io
import json

import pytest
from PIL import Image

from support import BLUE, BROKEN, GREEN, PHOTOGRAPHS, RED, Fingers, Server, discs, near, tell

PHONE = {
    "viewport": {"width": 390, "height": 780},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}


@pytest.fixture
def bent(opened):
    """Three handles, one of them moved: four steps."""
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.drag(RED, (140, 130))
    opened.ready()
    return opened.body("[data-kept=true]")


def whole(visit):
    visit.ready()
    return visit.warp(), visit["undo"], visit.page.title(), visit.saved("download")[1]


def other(folder, name="other.png", size=(330, 260)):
    return discs(folder / name, size)


def opens_file(visit, folder):
    visit.page.set_input_files("#file", other(folder))


def drops(visit, folder):
    tell(visit, ["dragover", "drop"], ("other.png", "image/png", other(folder).read_bytes()))


def pastes(visit, folder):
    tell(visit, ["paste"], ("other.png", "image/png", other(folder).read_bytes()))


def follows_a_link(visit, folder):
    id = visit.page.evaluate(
        """async (bytes) => {
          const form = new FormData();
          form.append("image", new Blob([Uint8Array.from(bytes)]), "other.png");
          form.append("warp", new Blob([JSON.stringify({ p: [] })], { type: "application/json" }));
          return (await (await fetch("sessions", { method: "POST", body: form })).json()).id;
        }""",
        list(other(folder).read_bytes()),
    )
    visit.page.evaluate("(id) => { location.hash = `session=${id}&name=other.png`; }", id)


@pytest.mark.parametrize("comes", [opens_file, drops, pastes, follows_a_link])
def test_another_picture_is_taken_back(bent, tmp_path, comes):
    before = whole(bent)
    comes(bent, tmp_path)
    bent.body("[data-handles='0'][data-state=ready]")
    assert bent.page.title().startswith("other.png") and bent["undo"] == "5"
    bent.page.click("#undo")
    bent.body("[data-handles='3']")
    assert whole(bent) == before and bent["redo"] == "1"
    # The older steps are those of this picture.
    bent.keys("Control+z")
    bent.ready()
    assert near(bent.posed(0), RED, 0.01)
    bent.keys("Control+y", "Control+y")
    bent.body("[data-handles='0'][data-state=ready]")
    assert bent.page.title().startswith("other.png")
    # A reload opens what was last seen, not the link.
    bent.keys("Control+z")
    bent.body("[data-handles='3'][data-kept=true]")
    bent.page.reload()
    assert whole(bent) == before


def test_a_sample_after_closing_is_taken_back(bent):
    before = whole(bent)
    bent.page.click("#close")
    data = bent.body("[data-state=empty]").data
    assert (data["handles"], data["session"], data["live"], data["source"], data["undo"]) == (
        "0",
        "",
        "off",
        "none",
        "5",
    )
    assert (
        bent.page.locator("#sample-cat").is_visible()
        and not bent.page.locator("#panel").is_visible()
    )
    bent.sample("cat")
    bent.page.click("#undo")
    bent.body("[data-handles='3']")
    assert whole(bent) == before
    bent.page.click("#redo")
    bent.body("[data-handles='11']").ready()


def test_closing_is_taken_back_by_keys_alone(bent):
    before = whole(bent)
    bent.page.focus("#close")
    bent.keys("Enter")
    bent.body("[data-state=empty]")
    focused = "document.activeElement.checkVisibility() && document.activeElement.id"
    assert bent.page.evaluate(focused) == "pick"
    bent.keys("Control+z")
    assert whole(bent) == before and bent.page.evaluate(focused) == "stage"
    bent.keys("Control+Shift+z")
    bent.body("[data-state=empty]")
    bent.page.click("#undo")
    assert whole(bent) == before
    # After a click, too, the focus is on the picture: keys work.
    assert bent.page.evaluate(focused) == "stage"
    # The mark leads to the start page too.
    bent.page.click("h1 a")
    bent.body("[data-state=empty]")
    bent.keys("Control+z")
    assert whole(bent) == before


def test_a_click_takes_no_focus_that_was_given_after_it(visits, picture):
    """Browsers run what a page does after a click when they have drawn, which may be later than the
    next action."""
    visit = visits()
    late = "{ const now = setTimeout; window.setTimeout = (f, ms = 0) => now(f, ms + 500); }"
    visit.page.add_init_script(late)
    visit.page.reload()
    visit.open(picture)
    visit.saved("download")
    visit.page.focus("#close")
    # The timer has run that was set before this one.
    visit.page.evaluate("new Promise((then) => setTimeout(then))")
    visit.keys("Enter")
    visit.body("[data-state=empty]")


def test_closing_is_taken_back_by_fingers(visits, picture):
    phone = visits(**PHONE).open(picture)
    fingers = Fingers(phone)
    fingers.tap(*phone.at(*RED))
    phone.body("[data-handles='1']").ready()

    def tap(id):
        box = phone.page.locator(f"#{id}").bounding_box()
        fingers.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    tap("close")
    phone.body("[data-state=empty]")
    tap("undo")
    assert phone.ready()["handles"] == "1"


def test_a_change_after_undo_ends_redo(bent, tmp_path):
    bent.page.set_input_files("#file", other(tmp_path))
    bent.body("[data-handles='0'][data-state=ready]")
    bent.page.click("#undo")
    bent.body("[data-handles='3']").ready()
    bent.click(50, 250)
    bent.body("[data-handles='4']").ready()
    assert (bent["redo"], bent["undo"]) == ("0", "5") and bent.page.locator("#redo").is_disabled()


def test_a_reload_keeps_the_pictures_before(bent, tmp_path):
    before = whole(bent)
    bent.page.set_input_files("#file", other(tmp_path))
    bent.body("[data-handles='0'][data-state=ready][data-kept=true]")
    bent.page.reload()
    bent.body("[data-state=ready]")
    assert bent["undo"] == "5"
    bent.page.click("#undo")
    bent.body("[data-handles='3']")
    assert whole(bent) == before
    bent.page.click("#close")
    bent.body("[data-state=empty]")
    bent.page.reload()
    bent.body("[data-undo='5']")
    assert bent["state"] == "empty"
    bent.page.click("#undo")
    assert whole(bent) == before


def test_a_session_that_has_ended_is_uploaded_again(visits, picture, tmp_path):
    server = Server()
    try:
        visit = visits(server).open(picture)
        visit.click(*RED)
        visit.drag(RED, (140, 130))
        before, session = whole(visit), visit["session"]
        visit.expects("404", *BROKEN)
        visit.page.click("#close")
        visit.body("[data-state=empty]")
        # Without the server the page stays as it is, and says so.
        server.kill()
        visit.page.click("#undo")
        visit.body("[data-state=empty][data-problem=network]")
        assert visit.text("problem-advice") == "Try again." and visit["undo"] == "3"
        server.start()
        visit.page.click("#problem-action")
        assert whole(visit) == before
        assert visit["session"] != session
    finally:
        server.stop()


STORED = """new Promise((then) => { indexedDB.open("mlswarp").onsuccess = ({ target }) =>
  (target.result.transaction("files").objectStore("files").count().onsuccess = ({ target }) =>
    then(target.result)); })"""


def test_the_last_few_pictures_are_kept(visit, tmp_path):
    for k in range(10):
        visit.open(other(tmp_path, f"p{k}.png", (300 + k, 200)))
        visit.body("[data-kept=true]")
        assert visit.page.evaluate(STORED) == min(k + 1, 8)
    assert visit["undo"] == "3"
    for k in (8, 7, 6):
        visit.keys("Control+z")
        visit.body(f"[data-state=ready][data-redo='{9 - k}']")
        assert visit.page.title().startswith(f"p{k}.png")
        assert Image.open(io.BytesIO(visit.saved("download")[1])).size == (300 + k, 200)
    visit.keys("Control+z")
    assert visit["undo"] == "0" and visit.page.locator("#undo").is_disabled()
    # As many files are stored, whatever was opened.
    assert visit.page.evaluate(STORED) == 8


def test_annotations_do_not_push_out_the_pictures_before(visit, tmp_path):
    """They are stored beside the pictures: the oldest file that nothing needs makes room."""

    def annotated(k, x):
        # A browser does not read a file that has changed since it was chosen, so each is a new one.
        shapes = tmp_path / f"cells-{k}-{x}.geojson"
        shapes.write_text(json.dumps({"type": "Point", "coordinates": [x, 50]}))
        visit.page.set_input_files("#file", shapes)
        visit.page.wait_for_selector(f"#toast.seen:text-is('{shapes.name} follows the warp')")
        visit.body("[data-annotations=exact]")

    for k in range(4):
        visit.open(other(tmp_path, f"p{k}.png", (300 + k, 200)))
        visit.body("[data-kept=true]")
        for x in (60, 70, 80, 90):
            annotated(k, x)
    visit.body("[data-kept=true]")
    visit.page.reload()
    visit.ready()
    assert visit.page.evaluate(STORED) == 8
    for k in (3, 2, 1, 0):
        visit.body("[data-annotations=exact]")
        assert visit.page.title().startswith(f"p{k}.png")
        saved = json.loads(visit.saved("annotations-save")[1])
        assert near(saved["coordinates"], (90, 50), 0.01)
        if k:
            visit.keys("Control+z")
            visit.body(f"[data-state=ready][data-redo='{4 - k}']")


def test_a_photograph_comes_back_under_its_name(visit):
    visit.open(PHOTOGRAPHS / "chelsea.png")
    visit.page.click("#pin-border")
    visit.ready()
    visit.page.set_input_files("#file", PHOTOGRAPHS / "rocket.jpg")
    visit.body("[data-handles='0'][data-state=ready]")
    visit.page.wait_for_selector("#toast.seen")
    assert visit.text("toast") == "rocket.jpg opened. Undo brings back chelsea.png"
    visit.keys("Control+z")
    visit.body("[data-handles='1']").ready()
    assert visit.text("title") == "chelsea.png"
