"""What the panel and the tools change: method, reach, grid, comparison, mesh, folds,
milliseconds."""

import io
import json
import re

import pytest
from PIL import Image

from support import BLUE, GREEN, RED, near


@pytest.fixture
def bent(opened):
    """Three points, two of them apart from where they rest."""
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.drag(RED, (140, 130))
    opened.drag(GREEN, (280, 110))
    opened.ready()
    return opened


def test_each_method_bends_in_its_own_way(bent):
    # Through three points, the spline is the affine map.
    bent.click(360, 260)
    bent.ready()
    pictures, notes = {"rigid": bent.saved("download")[1]}, {bent.text("method-note")}
    for method in ("similarity", "affine", "tps", "global_affine"):
        bent.page.click(f"label:has(#method-{method})")
        bent.ready()
        assert bent.warp()["method"] == method
        pictures[method] = bent.saved("download")[1]
        notes.add(bent.text("method-note"))
        assert pictures[method] == bent.of_server().body
        # One affine map does not take all four points to their targets.
        seen = bent.look()
        for name, place in (("red", (140, 130)), ("green", (280, 110)), ("blue", BLUE)):
            assert near(seen.centre(name), place, 3) or method == "global_affine", (method, name)
    assert len(set(pictures.values())) == len(notes) == 5
    for _ in range(4):
        bent.page.click("#undo")
    bent.ready()
    assert bent.saved("download")[1] == pictures["rigid"]


def test_a_spline_takes_pins_only(bent):
    before, usable = (
        bent.saved("download")[1],
        lambda name: bent.page.locator(f"#{name}").is_enabled(),
    )
    bent.page.click("#pin-border")
    bent.ready()
    assert not usable("method-tps") and "Spline, Global and Puppet are for pins only" in bent.text(
        "method-note"
    )
    bent.page.click("#undo")
    bent.ready()
    assert usable("method-tps") and "are for pins only" not in bent.text("method-note")
    bent.page.keyboard.press("Escape")
    bent.click(*BLUE)
    assert bent.page.locator("#rotate-left").is_visible()
    bent.page.click("label:has(#tool-line)")
    bent.page.click("label:has(#method-tps)")
    bent.ready()
    assert not any(
        usable(name) for name in ("tool-line", "tool-path", "pin-border", "alpha", "alpha-auto")
    )
    assert bent.page.locator("#tool-point").is_checked() and "no focus" in bent.text("alpha-note")
    assert (
        bent.warp()["method"] == "tps"
        and "alpha" not in bent.warp()
        and "smoothing" not in bent.warp()
    )
    assert bent.page.locator("#rotate-left").is_hidden(), "a selected pin has no twist"
    bent.page.keyboard.press("2")
    assert bent.page.locator(
        "#tool-point"
    ).is_checked() and "pins without a twist only" in bent.text("toast")
    bent.page.click("label:has(#method-rigid)")
    bent.ready()
    assert usable("tool-line") and bent.saved("download")[1] == before


def test_morph_takes_lines_only(opened):
    usable = lambda name: opened.page.locator(f"#{name}").is_enabled()  # noqa: E731
    assert usable("method-beier_neely") and usable("tool-point")
    opened.page.click("label:has(#method-beier_neely)")
    assert opened.page.locator("#tool-line").is_checked() and not usable("tool-point")
    assert "lines and paths only" in opened.text("method-note") and not usable("alpha")
    opened.drag((60, 40), (340, 40))
    opened.drag((60, 260), (340, 260))
    opened.ready()
    opened.drag((340, 40), (310, 90))
    opened.ready()
    warp = opened.warp()
    assert warp["method"] == "beier_neely" and warp["beier_neely"] == {"a": 1, "b": 2, "p": 0}
    assert "alpha" not in warp and not usable("method-tps")
    morph = opened.saved("download")[1]
    assert morph == opened.of_server().body
    opened.page.click("label:has(#method-rigid)")
    opened.ready()
    assert usable("tool-point") and opened.saved("download")[1] != morph


def test_the_smoothing_of_a_file_is_kept(opened):
    warp = {
        "p": [[40, 40], [300, 50], [50, 220], [320, 240], [180, 140]],
        "q": [[40, 40], [300, 50], [50, 220], [320, 240], [210, 150]],
    }
    file = {
        "name": "handles.json",
        "mimeType": "application/json",
        "buffer": json.dumps(warp | {"method": "tps", "smoothing": 0.1}).encode(),
    }
    opened.page.set_input_files("#file", [file])
    opened.body(f"[data-handles='{len(warp['p'])}']").ready()
    assert opened.page.locator("#method-tps").is_checked() and "Smoothing 0.1" in opened.text(
        "method-note"
    )
    assert (opened.warp()["method"], opened.warp()["smoothing"]) == ("tps", 0.1)
    smooth = opened.saved("download")[1]
    assert smooth == opened.of_server().body
    before = opened["revision"]
    opened.page.set_input_files(
        "#file", [file | {"buffer": json.dumps(warp | {"method": "tps"}).encode()}]
    )
    opened.body(f":not([data-revision='{before}'])").ready()
    assert "smoothing" not in opened.warp() and opened.saved("download")[1] != smooth


def test_reach_is_a_number_with_words(bent):
    first, words = bent.saved("download")[1], bent.text("alpha-note")
    bent.page.locator("#alpha").fill("3")
    bent.ready()
    assert bent.warp()["alpha"] == 3 and not bent.page.locator("#alpha-auto").is_checked()
    assert bent.text("alpha-note") != words
    assert bent.saved("download")[1] != first
    bent.page.check("#alpha-auto")
    bent.ready()
    assert bent.saved("download")[1] == first


def test_the_grid_is_chosen_and_said(bent):
    finer = bent.saved("download")[1]
    bent.page.select_option("#grid-size", "50")
    bent.ready()
    assert bent.warp()["grid"] == {"cell": 50}
    columns, rows = (int(n) for n in re.search(r"(\d+) × (\d+)", bent.text("grid-note")).groups())
    session = json.loads(bent.server.ask("GET", f"/sessions/{bent['session']}").body)
    assert (columns, rows) == (session["grid"]["columns"], session["grid"]["rows"]) == (9, 7)
    assert bent.saved("download")[1] == bent.of_server().body != finer


def middle(places):
    return sum(x for x, _ in places) / len(places), sum(y for _, y in places) / len(places)


def cells(visit):
    """Corners of every cell of the posed grid, as the server has it."""
    answer = visit.server.ask(
        "POST", f"/sessions/{visit['session']}/mesh", {"q": visit.warp()["q"]}
    )
    mesh = json.loads(answer.body)
    rows = [
        mesh["vertices"][k : k + mesh["columns"]]
        for k in range(0, len(mesh["vertices"]), mesh["columns"])
    ]
    return [
        [above[i], above[i + 1], below[i + 1], below[i]]
        for above, below in zip(rows, rows[1:])
        for i in range(len(above) - 1)
    ]


def inside(place):
    return 4 < place[0] < 396 and 4 < place[1] < 296


def test_the_mesh_is_drawn_where_the_picture_is(bent):
    bent.page.select_option("#grid-size", "50")
    bent.ready()
    plain = bent.look()
    bent.page.click("#mesh")
    lines = bent.look()
    assert 1000 < lines.differs(plain) < 0.5 * plain.image.width * plain.image.height
    # Lines cross where the server maps the vertices: it is lighter there, and nothing has changed
    # amid the cells.
    grid = cells(bent)
    assert len(grid) == 8 * 6
    vertices = [cell[0] for k, cell in enumerate(grid) if k >= 8 and k % 8 and inside(cell[0])]
    amid = [middle(cell) for cell in grid if inside(middle(cell))]
    assert len(vertices) > 30 and len(amid) > 40
    for x, y in vertices:
        around = [(x + dx, y + dy) for dx in (-0.6, 0, 0.6) for dy in (-0.6, 0, 0.6)]
        assert (
            max(min(lines.colour(*place)) - min(plain.colour(*place)) for place in around) > 15
        ), (x, y)
    assert [lines.colour(*place) for place in amid] == [plain.colour(*place) for place in amid]
    bent.page.click("#mesh")
    assert bent.look().differs(plain) == 0


def folds(cell):
    """A corner's cross product that is not positive: the rule by which the server counts."""
    a, b, c, d = cell
    turns = lambda p, q, r, s: (q[0] - p[0]) * (s[1] - r[1]) - (q[1] - p[1]) * (s[0] - r[0])
    return min(turns(a, b, a, d), turns(a, b, b, c), turns(d, c, b, c), turns(d, c, a, d)) <= 0


def test_folded_cells_are_red_and_counted_as_the_server_counts(bent):
    assert (bent["folds"], bent.text("folds-note")) == ("0", "")
    bent.page.select_option("#grid-size", "10")
    bent.drag((140, 130), (330, 240))
    told = int(bent.ready()["folds"])
    folded = [middle(cell) for cell in cells(bent) if folds(cell)]
    assert told == len(folded) == int(bent.of_server().headers["Warp-Folds"]) > 10
    assert bent.text("folds-note").startswith(f"{told} cells")
    assert bent.text("folds").startswith(f"{told} cells")
    redness = lambda look: [
        look.colour(*place)[0] - look.colour(*place)[1] for place in folded if inside(place)
    ]
    seen = redness(bent.look())
    assert sum(red > 60 for red in seen) > 0.8 * len(seen) > 8
    bent.keep("folds")
    bent.page.check("#remove-folds")
    assert int(bent.ready()["folds"]) == 0 == int(bent.of_server().headers["Warp-Folds"])
    bent.page.click("#undo")
    assert int(bent.ready()["folds"]) == told
    assert not bent.page.locator("#remove-folds").is_checked()
    bent.page.click("#undo")
    bent.ready()
    assert (bent["folds"], bent.text("folds-note")) == ("0", "")
    assert not bent.page.locator("#folds").is_visible()
    assert sum(red > 60 for red in redness(bent.look())) < 0.2 * len(seen)


def test_before_and_after(bent):
    after = bent.look()
    box = bent.page.locator("#before").bounding_box()
    bent.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    bent.page.mouse.down()
    before = bent.look()
    for name, place in (("red", RED), ("green", GREEN), ("blue", BLUE)):
        assert near(before.centre(name), place, 1), name
    bent.page.mouse.up()
    assert bent.look().differs(after) == 0
    bent.page.click("#compare")
    bent.page.locator("#compare-at").fill("50")
    halves = bent.look()
    # Left of the middle the original, right of it what it has become.
    assert near(halves.centre("red"), RED, 1)
    assert near(halves.centre("green"), after.centre("green"), 1)
    # The edge between them is taken in the picture as well.
    bent.drag((200, 20), (8, 20))
    assert int(bent.page.locator("#compare-at").input_value()) <= 3
    assert near(bent.look().centre("red"), (140, 130), 1.5)
    bent.page.click("#compare")
    assert bent.look().differs(after) == 0
    assert (bent["handles"], bent["undo"]) == ("3", "5")


def test_the_stages_are_told_in_milliseconds_on_request(bent):
    assert not bent.page.locator("#timing").is_visible() and "ms" not in bent.text("status")
    bent.page.click("#details summary")
    for stage in ("queue", "plan", "deform", "trip"):
        assert re.fullmatch(r"\d+\.\d+ ms", bent.text(f"timing-{stage}")), stage
    png = bent.saved("download")[1]
    assert bent.text("timing-size").startswith("400 × 300, ")
    kib = float(re.search(r"([\d.]+) KiB", bent.text("timing-size"))[1])
    assert abs(kib - len(png) / 1024) <= 0.5


def test_numbers_are_typed_in_the_table(bent):
    bent.page.fill("#q-1-0-y", "150")
    bent.page.keyboard.press("Enter")
    bent.page.fill("#p-2-0-x", "210")
    bent.page.keyboard.press("Tab")
    bent.ready()
    warp = bent.warp()
    assert warp["q"][1] == [280, 150] and warp["p"][2] == [210, BLUE[1]]
    assert near(bent.look().centre("green"), (280, 150), 2.5)
    # What is no number is not taken, and undo goes through the rest.
    bent.page.fill("#q-1-0-y", "")
    bent.page.keyboard.press("Tab")
    assert bent.page.input_value("#q-1-0-y") == "150"
    bent.page.click("#undo")
    bent.page.click("#undo")
    bent.ready()
    assert bent.page.input_value("#q-1-0-y") == "110" and bent.page.input_value("#p-2-0-x") == "200"


def test_all_are_put_back_and_all_are_deleted(bent, picture):
    bent.page.click("#put-back-all")
    bent.ready()
    assert bent.warp()["p"] == bent.warp()["q"]
    bent.page.click("#clear")
    bent.body("[data-handles='0'][data-state=ready]")
    png = bent.saved("download")[1]
    same = (
        Image.open(io.BytesIO(png)).convert("RGBA").tobytes()
        == Image.open(picture).convert("RGBA").tobytes()
    )
    assert same, "without handles the picture is as it came"
    bent.page.click("#undo")
    bent.page.click("#undo")
    bent.body("[data-handles='3']").ready()
    assert near(bent.posed(0), (140, 130), 0.6)


def test_a_handle_is_added_in_the_middle(opened):
    for tool in ("point", "line", "path"):
        opened.page.click(f"label:has(#tool-{tool})")
        opened.page.click("#add")
    opened.body("[data-handles='3']").ready()
    rest = opened.warp()["p"]
    assert near(rest[0], (200, 150), 1) and [len(h) for h in rest[1:]] == [2, 3]
