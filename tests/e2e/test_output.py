"""What is taken along: the picture, the handles, the command, the link. Each of them leads to the
same bytes by another way."""

import io
import json
import re
import shutil
import subprocess
from urllib.parse import parse_qs, urlsplit

import pytest
from PIL import Image

from support import BLUE, GREEN, PHOTOGRAPHS, PROGRAM, RED


def run(line, folder):
    """A copied command as a person would run it: in a shell, in a folder of its own."""
    (folder / "line.sh").write_text(f"set -eu\n{line}\n")
    done = subprocess.run(["sh", "line.sh"], cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and not done.stderr, (line, done.stderr)


def bend(visit):
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, (140, 130))
    visit.drag(BLUE, (220, 240))
    visit.ready()


@pytest.mark.parametrize(
    "name", ["discs.png", 'my discs, (1) "best"; 50%.png', "Pål's øre.png", "-o.png"]
)
def test_the_command_repeats_the_picture(visit, picture, tmp_path, name):
    here = tmp_path / "here"
    here.mkdir()
    named = here / name
    shutil.copy(picture, named)
    visit.open(named)
    bend(visit)
    png = visit.saved("download")[1]
    line = visit.copied("copy-curl")
    assert "\n" not in line
    run(line, here)
    made = [file for file in here.iterdir() if file.name not in (name, "line.sh")]
    assert [file.name for file in made] == [f"{name.removesuffix('.png')}-warped.png"]
    assert made[0].read_bytes() == png == visit.of_server().body
    assert Image.open(io.BytesIO(png)).size == (400, 300)


@pytest.mark.parametrize("photograph", ["rocket.jpg", "horse-cutout.png"])
def test_the_command_repeats_a_photograph_with_lines_and_every_choice(visit, tmp_path, photograph):
    shutil.copy(PHOTOGRAPHS / photograph, tmp_path)
    visit.open(tmp_path / photograph)
    if photograph == "horse-cutout.png":  # the line and the border lie beside the horse
        visit.page.click("label:has(#metric-euclidean)")
    visit.page.click("label:has(#tool-line)")
    visit.drag((100, 100), (300, 120))
    visit.page.click("label:has(#tool-point)")
    visit.click(200, 250)
    visit.drag((200, 250), (230, 270))
    visit.page.click("#pin-border")
    visit.page.click("label:has(#method-affine)")
    visit.page.locator("#alpha").fill("1.5")
    visit.page.select_option("#grid-size", "5")
    visit.ready()
    png = visit.saved("download")[1]
    run(visit.copied("copy-curl"), tmp_path)
    assert (tmp_path / f"{photograph.split('.')[0]}-warped.png").read_bytes() == png


@pytest.mark.parametrize("sample", ["cat", "horse"])
def test_the_command_of_a_sample_fetches_it_first(visit, tmp_path, sample):
    visit.sample(sample)
    png = visit.saved("download")[1]
    run(visit.copied("copy-curl"), tmp_path)
    assert (tmp_path / f"{sample}-warped.png").read_bytes() == png


def test_the_handles_bend_the_picture_offline_too(visit, picture, tmp_path):
    visit.open(picture)
    bend(visit)
    visit.page.click("label:has(#tool-path)")
    visit.click(40, 40)
    visit.click(360, 40)
    visit.page.mouse.dblclick(*visit.at(360, 260))
    visit.body("[data-handles='4']").ready()
    name, handles = visit.saved("save-handles")
    assert name == "discs-handles.json"
    (tmp_path / name).write_bytes(handles)
    warp = json.loads(handles)
    assert len(warp["p"]) == len(warp["q"]) == 4 and len(warp["p"][3]) == 3
    command = [PROGRAM, "warp", str(picture), name, "-o", "bent.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "bent.png").read_bytes() == visit.saved("download")[1]


def test_a_link_reopens_the_session_elsewhere(visit, visits, picture, tmp_path):
    visit.open(picture)
    bend(visit)
    png, look, link = visit.saved("download")[1], visit.look(), visit.copied("copy-link")
    parts = parse_qs(urlsplit(link).fragment)
    assert parts["session"] == [visit["session"]] and parts["name"] == ["discs.png"]
    # Another browser, which has neither the file nor anything else.
    other = visits(path=f"#{urlsplit(link).fragment}")
    other.ready()
    assert other["handles"] == "3" and other.page.title().startswith("discs.png")
    assert other.saved("download")[1] == png
    assert other.look().differs(look) == 0
    # Its command asks the session, as it has no file.
    run(other.copied("copy-curl"), tmp_path)
    assert (tmp_path / "discs-warped.png").read_bytes() == png
    # It can be bent on, and the one who gave the link keeps what they have.
    other.drag((140, 130), (100, 160))
    other.ready()
    other.click(60, 260)
    other.body("[data-handles='4']").ready()
    assert other.saved("download")[1] != png
    visit.page.reload()
    visit.ready()
    assert visit["handles"] == "3" and visit.saved("download")[1] == png


def test_what_is_asked_for_early_is_of_the_newest_pose(visit, picture):
    """A download that does not wait for the picture on the screen."""
    visit.open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, (140, 130))
    png = visit.saved("download")[1]
    visit.ready()
    assert png == visit.of_server().body


def test_a_link_says_until_when_it_works_and_a_dead_one_what_to_do(visit, visits, picture):
    visit.open(picture)
    bend(visit)
    link = visit.copied("copy-link")
    visit.page.wait_for_selector(
        "#link-note:text-matches('^It works until .*[0-9]{2}:[0-9]{2}, and for 15 minutes after "
        "each use[.]$')"
    )
    assert visit.text("toast") == f"Link copied. {visit.text('link-note')}"
    until = re.search(r"(\d\d):(\d\d)", visit.text("link-note"))
    session = json.loads(visit.server.ask("GET", f"/sessions/{visit['session']}").body)
    assert until[0] == visit.page.evaluate(
        "(time) => new Date(time).toTimeString().slice(0, 5)", session["expires"]
    )
    # The session ends; the link still has the handles.
    assert visit.server.ask("DELETE", f"/sessions/{visit['session']}").status == 204
    guest = visits(path=f"#{urlsplit(link).fragment}", expects=["404", "410"])
    guest.body("[data-problem=no_such_session], body[data-problem=session_expired]")
    assert guest.text("problem-title") == "This link no longer works"
    assert guest.text("problem-detail") == (
        "The link to discs.png has ended: the server deletes a picture 15 minutes after its "
        "last use."
    )
    assert (
        guest.text("waiting-text")
        == "The link has 3 handles. Choose the picture or sample that they belong to."
    )
    guest.keep("dead-link")
    guest.open(picture)
    guest.body("[data-handles='3']").ready()
    assert guest.saved("download")[1] == visit.saved("download")[1]
