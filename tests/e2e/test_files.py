"""Files that are opened together: which landmark file is rest and which pose, what is not used,
annotations, TIFF."""

import io
import json
import os

import pytest
from PIL import Image

from support import BLUE, GREEN, RED, Server, near, tell

REST, POSE = [RED, GREEN, BLUE], [(120, 110), (330, 100), (190, 250)]
SQUARE = [[80, 80], [120, 80], [120, 120], [80, 120], [80, 80]]
CELL = {
    "type": "Feature",
    "id": 7,
    "geometry": {"type": "Polygon", "coordinates": [SQUARE]},
    "properties": {"name": "red"},
}
CELLS = {
    "type": "FeatureCollection",
    "features": [
        CELL,
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [320, 90]},
            "properties": {},
        },
    ],
}


def pts(places):
    """An ibug file, whose pixels have their centres at whole numbers."""
    rows = "\n".join(f"{x + 0.5} {y + 0.5}" for x, y in places)
    return f"version: 1\nn_points: {len(places)}\n{{\n{rows}\n}}\n".encode()


def drop(visit, *files):
    tell(
        visit,
        ["dragover", "drop"],
        *(
            (name, media, value if isinstance(value, bytes) else json.dumps(value).encode())
            for name, media, value in files
        ),
    )


def changed(visit, *paths):
    """Brings files that were written again after they were chosen: browsers refuse to read them."""
    visit.page.evaluate(
        """() => document.body.append(Object.assign(document.createElement("input"),
             { type: "file", id: "chosen", multiple: true }))"""
    )
    visit.page.set_input_files("#chosen", paths)
    # A browser records size and time of a chosen file some time later, but before it reads it.
    visit.page.evaluate(
        """() => Promise.all(
             Array.from(document.querySelector("#chosen").files, (file) => file.arrayBuffer()))"""
    )
    for path in paths:
        path.write_bytes(path.read_bytes() + b"\n")
        # They tell by the time, which may be of the same second.
        os.utime(path, (0, 0))
    visit.page.evaluate(
        """() => {
          const carried = new DataTransfer();
          for (const file of document.querySelector("#chosen").files) carried.items.add(file);
          document.querySelector("#chosen").remove();
          document.body.dispatchEvent(new DragEvent("drop",
            { dataTransfer: carried, bubbles: true, cancelable: true }));
        }"""
    )


def sides(visit):
    warp = visit.warp()
    return [tuple(place) for place in warp["p"]], [tuple(place) for place in warp["q"]]


def test_two_landmark_files_are_rest_and_pose_in_the_order_of_their_names(visit, picture):
    drop(
        visit,
        ("face10.pts", "", pts(POSE)),
        ("discs.png", "image/png", picture.read_bytes()),
        ("face9.pts", "", pts(REST)),
    )
    visit.body("[data-handles='3']").ready()
    assert sides(visit) == (REST, POSE)
    assert (visit.text("sides-rest"), visit.text("sides-pose")) == ("face9.pts", "face10.pts")
    assert near(visit.look().centre("red"), POSE[0], 2)
    # One button exchanges them, as one step.
    visit.page.click("#sides-swap")
    visit.ready()
    assert sides(visit) == (POSE, REST)
    assert (visit.text("sides-rest"), visit.text("sides-pose")) == ("face10.pts", "face9.pts")
    visit.page.click("#undo")
    visit.ready()
    assert sides(visit) == (REST, POSE) and visit.text("sides-rest") == "face9.pts"
    visit.page.reload()
    visit.body("[data-handles='3']").ready()
    assert visit.text("sides-rest") == "face9.pts"
    visit.page.click("#sides-close")
    assert not visit.page.locator("#sides").is_visible()
    # Without the notice the panel has the same button.
    visit.page.click("#swap")
    visit.ready()
    assert sides(visit) == (POSE, REST)


@pytest.mark.parametrize("media", ["", "text/plain"])
def test_further_files_are_named(opened, media):
    more = ("c.csv", "text/csv", b"x,y\n1,2\n"), ("notes.docx", "", b"no")
    drop(opened, ("b.pts", media, pts(POSE)), ("a.pts", media, pts(REST)), *more)
    opened.body("[data-handles='3']").ready()
    assert opened.text("unused-text").startswith("Not used: c.csv and notes.docx.")
    opened.page.click("#unused-close")
    assert not opened.page.locator("#unused").is_visible()
    assert sides(opened) == (REST, POSE)


def test_a_file_with_both_sides_is_used_alone(opened):
    drop(
        opened,
        ("z.json", "application/json", {"p": [[100, 100]], "q": [[120, 110]]}),
        ("a.pts", "", pts(REST)),
    )
    opened.body("[data-handles='1']").ready()
    assert opened.text("unused-text").startswith("Not used: a.pts.")
    assert not opened.page.locator("#sides").is_visible()


def test_two_files_that_do_not_match_are_refused_by_their_names(opened):
    opened.expects("422")
    drop(opened, ("a.pts", "", pts(REST)), ("b.pts", "", pts(POSE[:2])))
    opened.body("[data-problem=bad_landmarks]")
    detail = opened.text("problem-detail")
    assert detail.startswith("In a.pts, line") and "landmarks_" not in detail
    assert opened["handles"] == "0"


def test_a_json_file_of_one_side_is_a_landmark_file_too(opened):
    drop(
        opened,
        ("b.json", "application/json", {"p": POSE}),
        ("a.json", "application/json", {"p": REST, "method": "affine"}),
    )
    opened.body("[data-handles='3']").ready()
    assert sides(opened) == (REST, POSE)


def test_a_swap_turns_a_twist_back(opened):
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.page.fill("#twist-0", "30")
    opened.keys("Enter")
    opened.ready()
    bent = opened.warp()
    opened.page.click("#swap")
    opened.ready()
    assert float(opened.page.input_value("#twist-0")) == -30
    opened.page.click("#swap")
    opened.ready()
    assert len(bent["q"][0]) == 2 and all(
        near(a, b, 0.05) for a, b in zip(opened.warp()["q"][0], bent["q"][0])
    )


def test_a_tiff_is_opened_and_drawn(visit, picture):
    with visit.page.expect_file_chooser() as chooser:
        visit.page.click("#pick")
    assert ".tif" in visit.page.get_attribute("#file", "accept") and "TIFF" in visit.text("limits")
    file = io.BytesIO()
    Image.open(picture).save(file, "TIFF", compression="tiff_lzw")
    chooser.value.set_files(
        [{"name": "discs.tif", "mimeType": "image/tiff", "buffer": file.getvalue()}]
    )
    visit.body("[data-state=ready]")
    look = visit.look()
    for name, place in (("red", RED), ("green", GREEN), ("blue", BLUE)):
        assert near(look.centre(name), place, 1), name
    visit.click(*RED)
    visit.drag(RED, (140, 130))
    visit.ready()
    assert near(visit.look().centre("red"), (140, 130), 2)
    # Browsers do not always know its media type.
    drop(visit, ("second.TIFF", "", file.getvalue()))
    visit.body("[data-handles='0'][data-state=ready]")
    assert visit.page.title().startswith("second.TIFF")


# The bounding box of what is drawn in the colour of annotations, px of the picture.
DRAWN = """([zoom, x, y]) => {
  const canvas = document.querySelector("#annotations");
  if (canvas.hidden) return null;
  const { data, width, height } =
    canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (let k = 0; k < width * height; k++) {
    if (data[4 * k] < 200 || data[4 * k + 1] < 180 || data[4 * k + 3] < 200) continue;
    const [u, v] = [k % width, Math.floor(k / width)];
    [box[0], box[1], box[2], box[3]] =
      [Math.min(box[0], u), Math.min(box[1], v), Math.max(box[2], u), Math.max(box[3], v)];
  }
  const [right, bottom] = [box[2] + 1, box[3] + 1];
  return [(box[0] - x) / zoom, (box[1] - y) / zoom, (right - x) / zoom, (bottom - y) / zoom];
}"""


def drawn(visit):
    data = visit.data
    return visit.page.evaluate(DRAWN, [float(data["zoom"]), *map(float, data["pan"].split(","))])


@pytest.mark.parametrize(
    "value", [CELL, [CELL], CELL["geometry"], {"type": "FeatureCollection", "features": [CELL]}]
)
def test_annotations_follow_the_warp(opened, value):
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.ready()
    drop(opened, ("cells.geojson", "", value))
    opened.body("[data-annotations=exact]")
    assert near(drawn(opened), (80, 80, 120, 120), 2)
    # In the hand by the page's grid, at rest by the server.
    with opened.without_pictures():
        opened.press(RED, (150, 130))
        opened.body(f"[data-moving=true][data-source=mesh][data-shown='{opened['revision']}']")
        assert opened["annotations"] == "mesh"
        followed = drawn(opened)
        opened.page.mouse.up()
    opened.body("[data-annotations=exact]").ready()
    left, top, right, bottom = exact = drawn(opened)
    assert near(((left + right) / 2, (top + bottom) / 2), (150, 130), 4)
    assert near(followed, exact, 1.5)
    # The original has them where they were.
    opened.page.focus("#stage")
    opened.page.keyboard.down("b")
    assert near(drawn(opened), (80, 80, 120, 120), 2)
    opened.page.keyboard.up("b")
    name, saved = opened.saved("annotations-save")
    assert name == "cells-warped.geojson"
    warp = opened.warp()
    answer = opened.server.ask(
        "POST", f"/sessions/{opened['session']}/points", {"q": warp["q"], "geojson": value}
    )
    assert json.loads(saved) == json.loads(answer.body)["geojson"]
    opened.page.click("#annotations-remove")
    assert opened["annotations"] == "" and drawn(opened) is None


def test_annotations_are_in_the_frame_of_another_canvas(opened):
    drop(opened, ("cells.geojson", "application/geo+json", CELLS))
    opened.body("[data-annotations=exact]")
    opened.page.select_option("#canvas", "box")
    for name, number in (("x", 50), ("y", 40), ("width", 300), ("height", 200)):
        opened.page.fill(f"#canvas-{name}", str(number))
        opened.keys("Enter")
    opened.body("[data-canvas='50,40,300,200'][data-annotations=exact]").ready()
    # Where they are in the picture, and in the file the place in the result.
    left, top, right, _ = drawn(opened)
    assert near((left, top, right), (80, 80, 323), 3)
    features = json.loads(opened.saved("annotations-save")[1])["features"]
    assert features[1]["geometry"]["coordinates"] == [270, 50]


def test_annotations_wait_for_their_picture_and_survive_undo(visit, picture):
    drop(visit, ("cells.geojson", "", CELLS))
    visit.page.wait_for_selector("#waiting")
    assert visit.text("waiting-text").startswith("cells.geojson has annotations.")
    visit.open(picture)
    visit.body("[data-annotations=exact]")
    assert visit.text("annotations-note") == "cells.geojson: 2 annotations, moved with the picture."
    visit.page.click("#close")
    visit.body("[data-state=empty]")
    visit.page.click("#undo")
    visit.body("[data-annotations=exact]")


def test_annotations_survive_a_reload_with_and_without_their_session(visits, picture):
    server = Server()
    visit = visits(server, expects=("410", "404"))
    visit.open(picture)
    for k in range(5):  # more than the files that are kept besides those that are needed
        drop(visit, (f"{k}.geojson", "", CELLS))
        visit.page.wait_for_selector(f"#annotations-note:text-matches('{k}.geojson')")
    visit.body("[data-annotations=exact]")
    visit.page.wait_for_function(
        '/"annotations":{"name":"4.geojson","key":\\d+}/.test(sessionStorage.mlswarp)'
    )
    before = drawn(visit)
    visit.page.reload()
    visit.body("[data-annotations=exact]").ready()
    assert drawn(visit) == before
    assert visit.text("annotations-note") == "4.geojson: 2 annotations, moved with the picture."
    assert len(json.loads(visit.saved("annotations-save")[1])["features"]) == 2
    server.ask("DELETE", f"/sessions/{visit['session']}")
    visit.page.reload()
    visit.body("[data-annotations=exact]").ready()
    assert drawn(visit) == before
    # What was removed stays away.
    visit.page.click("#annotations-remove")
    visit.page.reload()
    visit.ready()
    assert visit["annotations"] == "" and not visit.page.locator("#annotations-panel").is_visible()
    server.stop()


WINGS = b"""LM=2
100 200
320 210
IMAGE=other.jpg
ID=0
LM=3
100 199
320 209
200 79
IMAGE=discs.jpg
ID=1
"""


def chosen(visit):
    """The names in the dialog, and the selected one."""
    visit.page.wait_for_selector("#item[open]")
    return (
        visit.page.locator("#item-list option").all_inner_texts(),
        int(visit.page.input_value("#item-list")),
    )


def test_a_file_of_several_specimens_asks_which(opened):
    opened.expects("422")
    drop(opened, ("wings.tps", "", WINGS))
    assert chosen(opened) == (["1. other.jpg 0", "2. discs.jpg 1"], 1)
    assert (
        opened.text("item-note")
        == "wings.tps has 2 sets of landmarks. Choose the one for discs.png."
    )
    # y is up in this format: the height of the picture is 300.
    opened.keys("Enter")
    opened.body("[data-handles='3']").ready()
    assert near(opened.posed(0), (100, 100), 1) and near(opened.posed(2), (200, 220), 1)
    drop(opened, ("wings.tps", "", WINGS))
    opened.page.select_option("#item-list", "0")
    opened.page.click("#item-use")
    opened.body("[data-handles='2']").ready()
    # Closed without a choice, everything is as it was.
    drop(opened, ("wings.tps", "", WINGS))
    chosen(opened)
    opened.keys("Escape")
    opened.page.wait_for_selector("#item", state="hidden")
    assert (opened["handles"], opened["problem"]) == ("2", "")


def specimens(count):
    return "".join(f"LM=1\n{k % 100} 100\nIMAGE=wing_{k}.jpg\n" for k in range(count)).encode()


@pytest.mark.parametrize("typed", ["1150", "wing_1149.jpg"])
def test_of_more_items_than_are_listed_any_may_be_chosen(opened, typed):
    opened.expects("422")
    drop(opened, ("wings.tps", "", specimens(1200)))
    names, _ = chosen(opened)
    assert len(names) == 1000 and names[-1] == "1000. wing_999.jpg"
    assert opened.text("item-note").startswith("wings.tps has 1200 sets of landmarks.")
    assert opened.text("item-more-note").startswith("The first 1000 are listed.")
    opened.page.fill("#item-other", typed)
    opened.keys("Enter")
    opened.body("[data-handles='1']").ready()
    assert near(opened.posed(0), (49, 200), 1)
    # A name that no item has is said, and everything is as it was.
    drop(opened, ("wings.tps", "", specimens(1200)))
    chosen(opened)
    opened.page.fill("#item-other", "nobody")
    opened.keys("Enter")
    opened.body("[data-problem=bad_landmarks]")
    assert "nobody" in opened.text("problem-detail") and opened["handles"] == "1"
    drop(opened, ("wings.tps", "", WINGS))
    chosen(opened)
    assert not opened.page.locator("#item-other").is_visible()


def test_the_dialog_of_items_needs_no_mouse(opened):
    opened.expects("422")
    drop(opened, ("wings.tps", "", specimens(40)))
    chosen(opened)
    focused = "document.activeElement.id"
    assert opened.page.evaluate(focused) == "item-list"
    # Letters and digits go to an item, arrows to its neighbours.
    opened.page.keyboard.type("12")
    opened.keys("ArrowDown")
    assert opened.page.input_value("#item-list") == "12"
    opened.keys("Tab")
    assert opened.page.evaluate(focused) == "item-cancel"
    opened.keys("Tab")
    assert opened.page.evaluate(focused) == "item-use"
    opened.keys("Enter")
    opened.body("[data-handles='1']").ready()
    assert near(opened.posed(0), (12, 200), 1)
    assert opened.page.evaluate(focused) != "item-use"


@pytest.mark.parametrize("size", [(390, 844), (844, 390)])
def test_the_dialog_of_items_fits_a_phone(visits, picture, size):
    phone = visits(
        viewport={"width": size[0], "height": size[1]},
        has_touch=True,
        is_mobile=True,
        device_scale_factor=3,
    )
    phone.open(picture)
    phone.expects("422")
    drop(phone, ("wings.tps", "", specimens(1200)))
    chosen(phone)
    for id in ("item", "item-list", "item-other", "item-cancel", "item-use"):
        phone.page.locator(f"#{id}").scroll_into_view_if_needed()
        box = phone.page.locator(f"#{id}").bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= size[0]
        assert box["y"] >= 0 and box["y"] + box["height"] <= size[1] and box["height"] >= 44
    assert phone.page.locator("#item-list").bounding_box()["height"] >= 88
    phone.keep(f"item-{size[0]}")
    phone.page.tap("#item-use")
    phone.body("[data-handles='1']").ready()


def test_a_file_of_several_persons_waits_for_its_picture(visit, picture):
    visit.expects("422")
    persons = {
        "images": [{"id": 1, "file_name": "a.png"}, {"id": 2, "file_name": "discs.png"}],
        "annotations": [
            {"id": k, "image_id": k, "category_id": 1, "keypoints": [10 * k, 20, 2, 30, 40, 2]}
            for k in (1, 2)
        ],
        "categories": [{"id": 1, "keypoints": ["nose", "eye"]}],
    }
    drop(visit, ("coco.json", "", persons))
    visit.page.wait_for_selector("#waiting")
    assert (
        visit.text("waiting-text")
        == "coco.json has landmarks. Choose the picture or sample that they belong to."
    )
    visit.page.set_input_files("#file", picture)
    assert chosen(visit)[1] == 1
    visit.page.locator("#item-list option").nth(1).dblclick()
    visit.body("[data-handles='2']").ready()
    # Whole numbers are centres of pixels in this format.
    assert near(visit.posed(0), (20.5, 20.5), 0.01)


def test_rest_and_pose_are_chosen_one_after_the_other(opened):
    opened.expects("422")
    other = WINGS.replace(b"100 199", b"140 179").replace(b"discs", b"second")
    drop(opened, ("a.tps", "", WINGS), ("b.tps", "", other))
    assert chosen(opened)[1] == 1
    opened.page.click("#item-use")
    opened.page.wait_for_selector("#item-note:text-matches('b.tps has')")
    assert chosen(opened)[1] == 0
    opened.page.select_option("#item-list", "1")
    opened.page.click("#item-use")
    opened.body("[data-handles='3']").ready()
    p, q = opened.warp()["p"][0], opened.warp()["q"][0]
    assert near((q[0] - p[0], q[1] - p[1]), (40, 20), 0.01)


@pytest.mark.parametrize(
    "broken, words",
    [
        (
            b'{"type": "FeatureCollection", "features": [}',
            "In cells.geojson, line 1, column 44: a value is expected.",
        ),
        (
            b'{"kind": "cells"}',
            "In cells.geojson, a FeatureCollection, a Feature, a list of Features or a geometry "
            "is expected.",
        ),
    ],
)
def test_broken_annotations_say_what_is_wrong(opened, broken, words):
    drop(opened, ("cells.geojson", "application/geo+json", broken))
    opened.body("[data-problem=bad_annotations]")
    assert opened.text("problem-detail") == words


def test_annotations_that_the_server_refuses_are_removed(opened):
    opened.expects("422")
    broken = {
        "type": "Feature",
        "geometry": {"type": "Polygon", "coordinates": [[["a", 1]]]},
        "properties": {},
    }
    drop(opened, ("cells.geojson", "", broken))
    opened.body("[data-problem=bad_annotations]")
    assert (
        opened["annotations"] == ""
        and opened.text("problem-detail")
        == "In cells.geojson, at geometry.coordinates[0][0][0]: expected a number; found a string."
    )


@pytest.mark.parametrize(
    "name, content",
    [
        ("discs.png", None),
        ("cells.geojson", json.dumps(CELLS).encode()),
        ("handles.json", json.dumps({"p": [[1, 1]], "q": [[2, 2]]}).encode()),
        ("face.pts", pts(REST)),
        ("table.csv", b"1,2\n3,4\n"),
        ("discs.mlswarp.json", b'{"mlswarp_project": 1}'),
    ],
)
def test_a_file_that_changed_after_it_was_chosen_is_named(opened, tmp_path, picture, name, content):
    opened.click(*RED)
    path = tmp_path / name
    path.write_bytes(content or picture.read_bytes())
    changed(opened, path)
    opened.body("[data-problem=unreadable_file]")
    assert opened.text("problem-detail") == f"The browser cannot read {name}."
    assert (opened["handles"], opened["undo"]) == ("1", "1")
    opened.page.set_input_files("#file", path)
    opened.body(":not([data-problem=unreadable_file])")
