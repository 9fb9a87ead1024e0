"""A project: one file with the picture, its handles, the region, annotations and settings."""

import base64
import io
import json

import pytest
from PIL import Image

from support import BLUE, GREEN, RED, near
from test_files import CELLS, drop


@pytest.fixture(scope="module")
def project(browser, picture):
    """A saved project, and what it shows."""
    from support import Server, Visit

    server = Server()
    visit = Visit(browser, server)
    visit.open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, (140, 130))
    visit.page.fill("#twist-1", "25")
    visit.keys("Enter")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((40, 40), (180, 40), (180, 180), (40, 180))
    visit.page.click("label:has(#tool-brush)")
    visit.drag((300, 60), (340, 110))
    visit.page.locator("#feather").fill("12")
    visit.page.click("label:has(#tool-point)")
    visit.page.select_option("#holes", "transparent")
    visit.page.select_option("#outside", "edge")
    visit.page.select_option("#play-easing", "linear")
    visit.page.locator("#strength").fill("0.8")
    drop(visit, ("cells.geojson", "", CELLS))
    visit.body("[data-annotations=exact]").ready()
    name, text = visit.saved("save-project")
    told = {
        "project": text,
        "name": name,
        "png": visit.saved("download")[1],
        "warp": visit.warp(),
        "table": visit.posed(0),
    }
    assert not visit.trouble
    visit.close()
    server.stop()
    return told


def put(visit, value, name="discs-project.json"):
    buffer = value if isinstance(value, bytes) else json.dumps(value).encode()
    visit.page.set_input_files(
        "#file", {"name": name, "mimeType": "application/json", "buffer": buffer}
    )


def is_whole(visit, project):
    visit.body("[data-annotations=exact]").ready()
    data = visit.data
    assert (data["handles"], data["region"], data["strength"]) == ("3", "2", "0.8")
    assert visit.saved("download") == ("discs-warped.png", project["png"])
    assert visit.posed(0) == project["table"]
    assert (
        visit.page.input_value("#feather"),
        visit.page.input_value("#holes"),
        visit.page.input_value("#play-easing"),
    ) == ("12", "transparent", "linear")
    # Everything can still be changed: strength, strokes, twist.
    visit.page.locator("#strength").fill("1")
    visit.body("[data-strength='1']").ready()
    assert near(visit.posed(0), (140, 130), 0.6) and float(visit.page.input_value("#twist-1")) == 25


def test_a_project_is_opened_with_everything(visit, project):
    assert project["name"] == "discs-project.json"
    put(visit, project["project"])
    is_whole(visit, project)


def test_a_project_replaces_the_open_picture_as_one_step(visit, project):
    visit.sample("cat")
    drop(
        visit,
        ("discs-project.json", "application/json", project["project"]),
        ("extra.csv", "text/csv", b"x,y\n1,2\n"),
    )
    is_whole(visit, project)
    assert visit.text("unused-text").startswith("Not used: extra.csv.")
    for _ in range(2):
        visit.page.click("#undo")
    visit.body("[data-handles='11']").ready()


def test_a_project_of_a_tiff_and_of_a_link_has_its_picture(visit, visits, picture):
    file = io.BytesIO()
    Image.open(picture).save(file, "TIFF")
    visit.page.set_input_files(
        "#file", {"name": "discs.tif", "mimeType": "image/tiff", "buffer": file.getvalue()}
    )
    visit.body("[data-state=ready]")
    visit.click(*RED)
    visit.ready()
    told = json.loads(visit.saved("save-project")[1])
    assert (
        base64.b64decode(told["picture"]["base64"]) == file.getvalue()
        and told["picture"]["name"] == "discs.tif"
    )
    link = visit.copied("copy-link")
    guest = visits(path=link[link.index("#") :])
    guest.body("[data-handles='1']").ready()
    saved = guest.saved("save-project")[1]
    other = visits()
    put(other, saved)
    other.body("[data-handles='1']").ready()
    assert near(other.look().centre("red"), RED, 1.5)


def without(*path):
    def change(told):
        *parents, last = path
        for name in parents:
            told = told[name]
        del told[last]

    return change


def with_value(value, *path):
    def change(told):
        *parents, last = path
        for name in parents:
            told = told[name]
        told[last] = value

    return change


BROKEN = [
    (
        with_value(2, "mlswarp_project"),
        "1, the version that this page reads, is expected for mlswarp_project.",
    ),
    (
        without("picture"),
        "the picture, an object with name, type and base64, is expected for picture.",
    ),
    (with_value("", "picture", "name"), "a file name is expected for picture.name."),
    (
        with_value("no base64!", "picture", "base64"),
        "the picture's file in base64 is expected for picture.base64.",
    ),
    (without("warp"), "a warp object is expected for warp."),
    (
        with_value("x", "warp", "p", 1),
        "a position [x, y] or a list of positions is expected for warp.p[1].",
    ),
    (with_value("normalized", "warp", "units"), '"px" is expected for warp.units.'),
    (with_value(11, "strength"), "a number between -10 and 10 is expected for strength."),
    (
        with_value("pencil", "region", "parts", 0, "kind"),
        '"lasso", "brush", "invert" or "mask" is expected for region.parts[0].kind.',
    ),
    (
        with_value([[1, None]], "region", "parts", 0, "places"),
        "a list of positions [x, y] is expected for region.parts[0].places.",
    ),
    (
        with_value(-1, "region", "parts", 1, "size"),
        "a size in px, above 0, is expected for region.parts[1].size.",
    ),
    (
        with_value({"kind": "mask", "png": "AAAA"}, "region", "parts", 0),
        "masks that are PNG in base64 is expected for region.parts.",
    ),
    (with_value({}, "annotations", "geojson"), "GeoJSON is expected for annotations.geojson."),
    (
        with_value("avi", "animation", "file"),
        '"apng" or "gif" or "zip" is expected for animation.file.',
    ),
    (with_value(1, "animation", "frames"), "a number of frames, 2 to"),
]


def test_a_broken_project_says_what_is_wrong_and_changes_nothing(visit, project):
    visit.sample("cat")
    for change, words in BROKEN:
        told = json.loads(project["project"])
        change(told)
        visit.page.click("#problem-close") if visit["problem"] else None
        put(visit, told, "broken.json")
        visit.body("[data-problem=bad_project]")
        assert visit.text("problem-detail").startswith(f"In broken.json, {words}")
        assert (visit["handles"], visit["undo"], visit["state"]) == ("11", "0", "ready")
    put(visit, project["project"][:-20], "cut.json")
    visit.page.wait_for_selector(
        "#problem-detail:text-matches('^In cut.json, the JSON is damaged')"
    )
    # A file that is not a picture, and a mask of another picture.
    visit.expects("415", "422", "400")
    told = json.loads(project["project"])
    told["picture"]["base64"] = base64.b64encode(b"no picture").decode()
    put(visit, told)
    visit.body("[data-problem=unsupported_format]")
    assert visit["handles"] == "11"
    mask = io.BytesIO()
    Image.new("L", (20, 20), 255).save(mask, "PNG")
    told = json.loads(project["project"])
    told["region"]["parts"] = [{"kind": "mask", "png": base64.b64encode(mask.getvalue()).decode()}]
    put(visit, told)
    visit.page.wait_for_selector("#problem-detail:text-matches('20 × 20')")
    assert (visit["problem"], visit["handles"]) == ("bad_project", "11")
