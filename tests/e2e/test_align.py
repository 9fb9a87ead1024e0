"""A pose of another picture is aligned with the rest positions: by the panel, in files, links and
commands."""

import io
import json
import math

import pytest
from PIL import Image

from support import BLUE, GREEN, near
from test_files import REST, drop, pts
from test_output import run

# The discs as another picture has them: turned by 20 degrees, 0.6 times as large, elsewhere, and
# one of them truly moved.
TURN, SCALE = math.radians(20), 0.6


def other(x, y):
    return (
        30 + SCALE * (x * math.cos(TURN) - y * math.sin(TURN)),
        200 + SCALE * (x * math.sin(TURN) + y * math.cos(TURN)),
    )


MOVED = [(130, 90), GREEN, BLUE, (60, 250)]
P = [*REST, (60, 250)]
Q = [tuple(round(c, 2) for c in other(*place)) for place in MOVED]


@pytest.fixture
def posed(opened):
    drop(opened, ("a.pts", "", pts(P)), ("b.pts", "", pts(Q)))
    opened.body("[data-handles='4']").ready()
    return opened


def of_the_server(visit, **fields):
    """The picture that the server makes of the file's pose and an alignment."""
    name, handles = visit.saved("save-handles")
    body = {**json.loads(handles), **fields}
    session = visit.server.ask("POST", "/points", {**body, "extent": [400, 300], "points": P})
    assert session.status == 200, session.body
    return json.loads(session.body)["points"]


@pytest.mark.parametrize("by", ["rigid", "similarity", "affine"])
def test_the_page_and_the_server_align_alike(posed, by):
    plain = posed.warp()
    assert "align" not in plain
    posed.page.select_option("#align", by)
    posed.body(f"[data-align={by}]").ready()
    warp = posed.warp()
    assert (warp["align"], warp["q"]) == (by, plain["q"]), "a file has the pose as it was"
    # The handles are where the server puts what they hold.
    for index, place in enumerate(of_the_server(posed)):
        assert near(posed.posed(index), place, 1.5), (by, index)
    posed.page.select_option("#align", "none")
    posed.body("[data-align=none]").ready()
    assert posed.warp() == plain
    posed.page.click("#undo")
    posed.body(f"[data-align={by}]").ready()
    assert posed.warp() == warp


def test_what_was_only_moved_turned_and_scaled_is_at_rest_again(opened):
    drop(
        opened,
        ("a.pts", "", pts(P)),
        ("b.pts", "", pts([tuple(round(c, 4) for c in other(*place)) for place in P])),
    )
    opened.body("[data-handles='4']").ready()
    opened.page.click("#sides-align")
    opened.body("[data-align=similarity]").ready()
    assert not opened.page.locator("#sides-align").is_visible()
    for index, place in enumerate(P):
        assert near(opened.posed(index), place, 0.02)


def test_an_edit_applies_the_alignment(posed):
    posed.page.select_option("#align", "similarity")
    posed.body("[data-align=similarity]").ready()
    where = [posed.posed(index) for index in range(4)]
    x, y = where[1]
    posed.drag((x, y), (x - 20, y + 10))
    posed.body("[data-align=none]").ready()
    warp = posed.warp()
    assert "align" not in warp and near(warp["q"][1], (x - 20, y + 10), 0.6)
    assert all(near(warp["q"][k], where[k], 0.01) for k in (0, 2, 3))


def test_a_strength_counts_after_the_alignment(posed):
    posed.page.select_option("#align", "similarity")
    posed.body("[data-align=similarity]").ready()
    whole = [posed.posed(index) for index in range(4)]
    posed.page.locator("#strength").fill("0.5")
    posed.body("[data-strength='0.5']").ready()
    for index, (place, full) in enumerate(zip(P, whole)):
        assert near(posed.posed(index), [(a + b) / 2 for a, b in zip(place, full)], 0.02)
    assert "align" not in posed.warp(), "the shown pose is told as it is"
    posed.page.locator("#strength").fill("1")
    posed.body("[data-strength='1']").ready()
    assert posed.warp()["align"] == "similarity"


def test_it_survives_files_links_commands_and_a_reload(posed, visits, tmp_path, picture):
    posed.page.select_option("#align", "similarity")
    posed.body("[data-align=similarity]").ready()
    where = [posed.posed(index) for index in range(4)]
    warp, png = posed.warp(), posed.saved("download")[1]
    (tmp_path / "discs.png").write_bytes(picture.read_bytes())
    run(posed.copied("copy-curl"), tmp_path)
    ours, theirs = (
        Image.open(io.BytesIO(file)).convert("RGB")
        for file in (png, (tmp_path / "discs-warped.png").read_bytes())
    )
    # The page rounds what it has aligned to a hundredth of a pixel.
    assert sum(abs(a - b) > 8 for a, b in zip(ours.tobytes(), theirs.tobytes())) < 0.002 * len(
        ours.tobytes()
    )
    link = posed.copied("copy-link")
    posed.page.reload()
    posed.body("[data-align=similarity]").ready()
    assert posed.warp() == warp
    guest = visits(path=link[link.index("#") :])
    guest.body("[data-align=similarity]").ready()
    assert guest.warp() == warp and all(near(guest.posed(k), where[k], 0.02) for k in range(4))
    file = {
        "name": "aligned.json",
        "mimeType": "application/json",
        "buffer": json.dumps(warp).encode(),
    }
    fresh = visits().open(picture)
    fresh.page.set_input_files("#file", [file])
    fresh.body("[data-align=similarity]").ready()
    assert fresh.warp() == warp and all(near(fresh.posed(k), where[k], 0.02) for k in range(4))
    # Normalised positions are aligned in pixels.
    shares = {
        **warp,
        "units": "normalized",
        **{side: [[x / 400, y / 300] for x, y in warp[side]] for side in "pq"},
    }
    fresh.page.set_input_files("#file", [{**file, "buffer": json.dumps(shares).encode()}])
    fresh.body("[data-undo='2'][data-align=similarity]").ready()
    assert all(near(fresh.posed(k), where[k], 0.02) for k in range(4))


def test_a_swap_aligns_the_other_way_round(posed):
    posed.page.click("#sides-align")
    posed.body("[data-align=similarity]").ready()
    posed.page.click("#sides-swap")
    posed.body("[data-align=similarity]").ready()
    warp = posed.warp()
    assert [tuple(place) for place in warp["p"]] == Q and [tuple(place) for place in warp["q"]] == P
    assert near(posed.posed(2), other(*BLUE), 8)
