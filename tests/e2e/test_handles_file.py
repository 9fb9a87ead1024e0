"""Files with handles: opened on a picture, before it or with it; what is wrong with a file is said
with its name and position."""

import base64
import io
import json

import pytest
from PIL import Image

from support import RED, near, tell

HANDLES = {
    "p": [[100, 100], [[20, 30], [300, 40]]],
    "q": [[140, 130], [[20, 30], [300, 60]]],
    "method": "affine",
}


def file(name="face.json", value=HANDLES):
    return {
        "name": name,
        "mimeType": "application/json",
        "buffer": value if isinstance(value, bytes) else json.dumps(value).encode(),
    }


def is_posed(visit):
    visit.body("[data-handles='2']").ready()
    warp = visit.warp()
    assert (warp["p"], warp["q"], warp["method"]) == (HANDLES["p"], HANDLES["q"], "affine")


def test_handles_are_opened_by_their_button(opened):
    opened.click(*RED)
    opened.ready()
    with opened.page.expect_file_chooser() as chooser:
        opened.page.click("#open-handles")
    chooser.value.set_files([file()])
    is_posed(opened)
    assert opened.text("toast") == "2 handles from face.json"
    opened.page.click("#undo")
    opened.body("[data-handles='1']").ready()
    assert near(opened.posed(0), RED, 0.01)


def test_handles_on_the_start_page_wait_for_their_picture(visit, picture):
    tell(
        visit, ["dragover", "drop"], ("face.json", "application/json", json.dumps(HANDLES).encode())
    )
    visit.page.wait_for_selector("#waiting")
    assert (
        visit.text("waiting-text")
        == "face.json has 2 handles. Choose the picture or sample that they belong to."
    )
    assert (visit["state"], visit["problem"]) == ("empty", "")
    visit.page.set_input_files("#file", picture)
    is_posed(visit)
    assert visit["undo"] == "1"
    visit.page.click("#close")
    visit.body("[data-state=empty]")
    assert not visit.page.locator("#waiting").is_visible()


def test_handles_that_wait_are_for_a_sample_too_or_are_discarded(visit):
    visit.page.set_input_files("#file", [file()])
    visit.page.wait_for_selector("#waiting")
    visit.page.focus("#waiting-drop")
    visit.keys("Enter")
    assert (
        not visit.page.locator("#waiting").is_visible()
        and visit.page.evaluate("document.activeElement.id") == "pick"
    )
    visit.page.set_input_files("#file", [file()])
    visit.page.click("#sample-cat")
    is_posed(visit)
    visit.page.click("#undo")
    visit.body("[data-handles='11']").ready()


@pytest.mark.parametrize("is_open", [False, True])
def test_a_picture_and_its_handles_come_together(visit, picture, is_open):
    if is_open:
        visit.sample("cat")
    tell(
        visit,
        ["dragover", "drop"],
        ("face.json", "application/json", json.dumps(HANDLES).encode()),
        ("discs.png", "image/png", picture.read_bytes()),
    )
    visit.body("[data-handles='2']")
    is_posed(visit)
    assert visit.page.title().startswith("discs.png")


def test_a_tolerance_in_a_file_is_kept_and_shown(opened):
    opened.page.set_input_files("#file", [file(value={**HANDLES, "grid": {"tolerance": 1}})])
    is_posed(opened)
    assert opened.warp()["grid"] == {"tolerance": 1}
    assert opened.page.locator("#grid-size option:checked").inner_text() == "Within 1 px"
    opened.page.select_option("#grid-size", "5")
    opened.ready()
    assert opened.warp()["grid"] == {"cell": 5}
    opened.page.select_option("#grid-size", label="Within 1 px")
    opened.ready()
    assert opened.warp()["grid"] == {"tolerance": 1}


def test_the_policy_for_coincident_handles_is_kept(opened):
    policy = {"policy": "mean", "within": 30}
    handles = {
        "p": [[100, 100], [110, 100], [300, 40]],
        "q": [[140, 130], [150, 130], [300, 60]],
        "coincident": policy,
    }
    opened.page.set_input_files("#file", [file(value=handles)])
    opened.body("[data-handles='3']").ready()
    assert opened.warp()["coincident"] == policy
    opened.page.reload()
    opened.body("[data-handles='3']").ready()
    assert opened.warp()["coincident"] == policy
    # Without a policy, the next file has the default again.
    opened.page.set_input_files("#file", [file()])
    is_posed(opened)
    assert "coincident" not in opened.warp()


BROKEN = [
    (b'{\n  "p": [[1, 2], [3, 4]],\n  "q": [[1, 2] [3, 4]]\n}', 3, 16, "a comma or ]"),
    (b'{"p": [[1, 2],]}', 1, 15, "a value"),
    (b'{"p": [[1, 2]]', 1, 15, "a comma or }"),
    (b"{'p': []}", 1, 2, "a name in double quotes"),
    (b'{"p" [1]}', 1, 6, "a colon"),
    (b'{"p": []} x', 1, 11, "the end of the file"),
    (b"", 1, 1, "a value"),
    (b"[" * 100_000, 1, 22, "fewer brackets"),
    (b"[]", 1, 1, "an object with the handles at rest"),
    (b'{"p": 5}', 1, 7, "a list of handles is expected for p."),
    (
        b'{\n "p": [[1, 2]],\n "q": []\n}',
        3,
        7,
        "a list of 1 handles, as many as in p, is expected for q.",
    ),
    (
        b'{"p": [[1, 2],\n [3, "4"]]}',
        2,
        2,
        "a position [x, y] or a list of positions is expected for p[1].",
    ),
    (b'{"p": [[[1, 2], [3]]]}', 1, 17, "a position [x, y] of two numbers is expected for p[0][1]."),
    (
        b'{"p": [[1, 2]], "method": "idw2"}',
        1,
        27,
        'one of "rigid", "similarity", "affine", "tps", "global_affine", "beier_neely", '
        '"arap" is expected for method.',
    ),
    (
        b'{"p": [[1, 2], [[3, 4], [5, 6]]], "method": "tps"}',
        1,
        16,
        'because the method "tps" takes points only on this page, is expected for p[1].',
    ),
    (b'{"p": [[1, 2]], "units": "mm"}', 1, 26, '"px" or "normalized" is expected for units.'),
    (
        b'{"p": [[1, 2]], "grid": {"tolerance": 9}}',
        1,
        25,
        '"auto", {"tolerance": px} between 0.05 and 4, or {"cell": px} is expected for grid.',
    ),
    (
        b'{"p": [[1, 2]], "coincident": {"within": -1}}',
        1,
        42,
        "a distance in px, 0 to 1000000, is expected for coincident.within.",
    ),
    (b'{"p": [[1, 2]], "output": {"outside": "red"}}', 1, 39, "is expected for output.outside."),
]


@pytest.mark.parametrize("text, line, column, expected", BROKEN)
def test_a_broken_file_is_named_with_the_position_and_what_is_expected(
    visit, text, line, column, expected
):
    visit.page.set_input_files("#file", [file("lm handles 3.json", text)])
    visit.body("[data-problem=bad_handles_file][data-state=empty]")
    detail = visit.text("problem-detail")
    assert (
        detail.startswith(f"In lm handles 3.json, line {line}, column {column}: ")
        and expected in detail
    ), detail
    assert "ndo" not in visit.text("problem-advice")


def test_a_broken_file_changes_nothing(opened):
    opened.click(*RED)
    opened.ready()
    opened.page.set_input_files("#file", [file(value=BROKEN[0][0])])
    opened.body("[data-problem=bad_handles_file]")
    assert (opened["handles"], opened["undo"], opened["state"]) == ("1", "1", "ready")
    assert (
        not opened.page.locator("#problem-action").is_visible()
        or opened.page.locator("#problem-action").inner_text() != "Undo"
    )


def test_a_large_file_is_not_read(visit):
    visit.page.set_input_files("#file", [file(value=b" " * (16 * 1024 * 1024 + 1))])
    visit.body("[data-problem=bad_handles_file]")
    assert visit.text("problem-detail") == "The file face.json is too large for a file of handles."


def test_the_region_is_saved_with_the_handles_and_opened_again(opened):
    """The same picture comes back, after the region was cleared, on the reopened picture, and by
    curl as the refusal says."""
    opened.click(*RED)
    opened.drag(RED, (140, 130))
    opened.page.click("label:has(#tool-lasso)")
    opened.drag((60, 60), (150, 60), (150, 150), (60, 150), (60, 60))
    opened.page.locator("#feather").fill("12")
    opened.body("[data-region='1']").ready()
    shown = opened.of_server().body
    name, content = opened.saved("save-handles")
    saved = json.loads(content)
    assert (
        name == "discs-handles.json"
        and base64.b64decode(saved["region"]).startswith(b"\x89PNG")
        and saved["p"] == opened.warp()["p"]
    )
    opened.page.click("#region-clear")
    opened.body("[data-region='0']").ready()
    whole = opened.of_server().body
    assert whole != shown
    opened.page.set_input_files("#file", [file(name, saved)])
    opened.body("[data-region='1']").ready()
    assert opened.of_server().body == shown
    # Opening is one step.
    opened.keys("Control+z")
    opened.body("[data-region='0']").ready()
    assert opened.of_server().body == whole
    opened.keys("Control+Shift+z")
    opened.body("[data-region='1']").ready()
    assert opened.of_server().body == shown
    # A file without a region keeps the one that is there.
    opened.page.set_input_files(
        "#file",
        [file("bare.json", {**{"p": saved["p"], "q": saved["q"]}, "method": saved["method"]})],
    )
    opened.page.locator("#toast", has_text="from bare.json").wait_for()
    opened.ready()
    assert opened["region"] == "1"


def test_a_region_that_is_none_or_of_another_picture_is_refused(opened):
    opened.page.set_input_files("#file", [file("bad.json", {**HANDLES, "region": "not base64!"})])
    opened.body("[data-problem=bad_handles_file]")
    assert "the mask of a region, a PNG in base64, is expected for region." in opened.text(
        "problem-detail"
    )
    opened.page.set_input_files("#file", [file("no-png.json", {**HANDLES, "region": "AAAA"})])
    opened.page.locator("#problem-detail", has_text="In no-png.json").wait_for()
    small = io.BytesIO()
    Image.new("L", (20, 10), 255).save(small, "PNG")
    opened.page.set_input_files(
        "#file",
        [file("small.json", {**HANDLES, "region": base64.b64encode(small.getvalue()).decode()})],
    )
    opened.page.locator(
        "#problem-detail",
        has_text="The region in small.json has 20 × 10 px, and the picture 400 × 300 px",
    ).wait_for()
    assert (opened["handles"], opened["region"]) == ("0", "0")


@pytest.mark.parametrize("options", [{}, {"viewport": {"width": 390, "height": 780}}])
def test_a_problem_covers_no_sample(visits, options):
    visit = visits(**options)
    visit.page.set_input_files("#file", [file(value=b"[")])
    visit.body("[data-problem=bad_handles_file]")
    alert = visit.page.locator("#problem").bounding_box()
    for id in ("pick", "sample-portrait", "sample-cat", "sample-horse", "sample-rocket"):
        box = visit.page.locator(f"#{id}").bounding_box()
        assert box["y"] >= alert["y"] + alert["height"], id


PTS = b"version: 1\nn_points: 2\n{\n100.5 100.5\n200.5 140.5\n}\n"
# As MediaPipe and ARKit list them: shares of the picture's size.
SHARES = b'[{"x": 0.25, "y": 0.5, "z": 0}, {"x": 0.5, "y": 0.1, "z": 0}]'


def landmarks(name, content, kind=""):
    return {"name": name, "mimeType": kind, "buffer": content}


def test_landmark_files_of_other_programs_are_opened(opened):
    opened.page.set_input_files("#file", [landmarks("face.pts", PTS)])
    opened.body("[data-handles='2']").ready()
    # ibug counts the pixels from 1, and this service their corners from 0.
    assert (
        opened.warp()["p"] == [[100, 100], [200, 140]]
        and opened.text("toast") == "2 handles from face.pts"
    )
    opened.page.set_input_files(
        "#file", [landmarks("moved.csv", b"px,py,qx,qy\n100,100,140,130\n", "text/csv")]
    )
    opened.body("[data-handles='1']").ready()
    assert (opened.warp()["p"], opened.warp()["q"]) == ([[100, 100]], [[140, 130]])
    opened.page.click("#undo")
    opened.body("[data-handles='2']").ready()
    opened.page.set_input_files("#file", [landmarks("mesh.json", SHARES, "application/json")])
    opened.page.locator("#toast", has_text="from mesh.json").wait_for()
    opened.ready()
    assert opened.warp()["p"] == [[100, 150], [200, 30]], "of 400 x 300 px"


def test_normalised_landmarks_wait_for_the_size_of_their_picture(visit, picture):
    visit.page.set_input_files("#file", [landmarks("mesh.json", SHARES, "application/json")])
    visit.page.wait_for_selector("#waiting")
    assert "2 handles" in visit.text("waiting-text")
    visit.page.set_input_files("#file", picture)
    visit.body("[data-handles='2']").ready()
    assert visit.warp()["p"] == [[100, 150], [200, 30]]


def test_a_broken_landmark_file_is_named_with_its_position(opened):
    opened.expects("422")
    opened.page.set_input_files("#file", [landmarks("face.csv", b"x,y\n100,1O0\n", "text/csv")])
    opened.body("[data-problem=bad_landmarks]")
    assert opened.text("problem-detail").startswith(
        "In face.csv, line 2, column 5: expected a number"
    )
    assert (opened["handles"], opened["state"]) == ("0", "ready")


def test_points_are_saved_as_a_landmark_file(opened):
    opened.drag(RED, (140, 130))
    opened.click(*RED)
    opened.ready()
    name, content = opened.saved("save-landmarks")
    assert (
        name == "discs-landmarks.csv"
        and content.startswith(b"px,py,qx,qy\n")
        and content.count(b"\n") == int(opened["handles"]) + 1
    )
    warp = opened.warp()
    opened.page.set_input_files("#file", [landmarks(name, content, "text/csv")])
    opened.page.locator("#toast", has_text=f"from {name}").wait_for()
    opened.ready()
    assert (opened.warp()["p"], opened.warp()["q"]) == (warp["p"], warp["q"])
