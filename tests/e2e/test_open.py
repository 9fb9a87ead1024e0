"""Opening a picture: a sample, a picked, dropped or pasted file; the progress of an upload."""

import base64
import io
import random
import re

import pytest
from PIL import Image

from support import BLUE, GREEN, PHOTOGRAPHS, RED, near, tell


def test_an_empty_page_says_what_to_do(visit):
    data = visit.data
    assert (data["state"], data["source"], data["handles"], data["live"]) == (
        "empty",
        "none",
        "0",
        "off",
    )
    assert visit.page.locator("#drop").is_visible()
    assert re.search(r"32 MiB.*50 megapixels", visit.text("limits"))
    for control in ("undo", "stage", "panel", "download", "close", "export-open", "waiting"):
        assert not visit.page.locator(f"#{control}").is_visible(), control


def test_the_policy_is_strict(visit):
    policy = dict(
        part.strip().partition(" ")[::2]
        for part in visit.answer.headers["content-security-policy"].split(";")
    )
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert policy["base-uri"] == policy["form-action"] == policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in str(policy)


@pytest.mark.parametrize(
    "name, size",
    [("portrait", (512, 512)), ("cat", (451, 300)), ("horse", None), ("rocket", (640, 427))],
)
def test_a_sample_comes_bent(visit, name, size):
    before = {
        "portrait": "portrait.jpg",
        "cat": "cat.jpg",
        "horse": "horse.webp",
        "rocket": "rocket.jpg",
    }[name]
    file = visit.server.ask("GET", f"/page/{before}").body
    visit.sample(name)
    data = visit.data
    assert int(data["handles"]) >= 3 and data["webgl"].startswith("webgl")
    file_name, png = visit.saved("download")
    assert file_name == f"{name}-warped.png"
    bent, source = Image.open(io.BytesIO(png)), Image.open(io.BytesIO(file))
    assert bent.size == source.size and (size is None or bent.size == size)
    assert bent.convert("RGB").tobytes() != source.convert("RGB").tobytes()
    assert png == visit.of_server().body
    visit.keep(f"sample-{name}")


def is_seen_as_it_came(visit):
    look = visit.look()
    for name, place in (("red", RED), ("green", GREEN), ("blue", BLUE)):
        assert near(look.centre(name), place, 1), name


def test_a_file_is_picked(visit, picture):
    with visit.page.expect_file_chooser() as chooser:
        visit.page.click("#pick")
    chooser.value.set_files(picture)
    data = visit.body("[data-state=ready]").data
    assert (data["handles"], data["undo"], data["problem"]) == ("0", "0", "")
    assert visit.page.title() == "discs.png – mlswarp"
    is_seen_as_it_came(visit)


def test_a_file_is_dropped(visit, picture):
    tell(visit, ["dragenter"], ("discs.png", "image/png", picture.read_bytes()))
    assert visit.page.locator("#over").is_visible()
    # A drop that the page did not take would open the file in its place.
    assert tell(visit, ["dragover", "drop"], ("discs.png", "image/png", picture.read_bytes())) == [
        True,
        True,
    ]
    visit.body("[data-state=ready]")
    assert not visit.page.locator("#over").is_visible()
    is_seen_as_it_came(visit)


def test_a_picture_is_pasted(visit, picture):
    # As the browser does it: a picture on the clipboard, and the keys.
    visit.page.evaluate(
        """async (base64) => {
          const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
          await navigator.clipboard.write([new ClipboardItem({ "image/png": new Blob([bytes],
            { type: "image/png" }) })]);
        }""",
        base64.b64encode(picture.read_bytes()).decode(),
    )
    visit.keys("Control+v")
    visit.body("[data-state=ready]")
    is_seen_as_it_came(visit)


def test_saved_handles_are_dropped_on_an_open_picture(opened):
    opened.click(*RED)
    opened.drag(RED, (140, 130))
    opened.ready()
    name, saved = opened.saved("save-handles")
    assert name == "discs-handles.json"
    png = opened.saved("download")[1]
    opened.page.click("#clear")
    opened.body("[data-handles='0'][data-state=ready]")
    tell(opened, ["dragover", "drop"], (name, "application/json", saved))
    opened.body("[data-handles='1']").ready()
    assert opened.saved("download")[1] == png


def test_a_picture_is_opened_under_a_name_of_the_page(visit, picture):
    """A proxy that hashes the name in the path sends the upload to the replica that will get the
    drags."""
    asked = []
    visit.page.on("request", lambda request: asked.append((request.method, request.url)))
    # As over plain HTTP to another machine.
    visit.page.evaluate("() => Object.defineProperty(crypto, 'randomUUID', { value: undefined })")
    visit.open(picture).ready()
    uploads = [
        url
        for method, url in asked
        if method in ("POST", "PUT") and url.split("/")[-2] == "sessions"
    ]
    assert [url.rsplit("/", 1)[1] for url in uploads] == [visit["session"]]
    assert visit["session"][14] == "4" and visit["session"][19] in "89ab"


def test_another_picture_takes_the_place_of_the_first(opened, tmp_path):
    opened.click(*RED)
    opened.ready()
    first = opened["session"]
    with opened.page.expect_file_chooser() as chooser:
        opened.page.click("#open")
    chooser.value.set_files(PHOTOGRAPHS / "chelsea.png")
    opened.body(f"[data-state=ready]:not([data-session='{first}'])")
    # The step of the first picture, and its replacement: test_undo.py takes both back.
    assert (opened["handles"], opened["undo"]) == ("0", "2")
    assert opened.page.title().startswith("chelsea.png")


def noise(path):
    """A picture that no coder makes small: 1 MB of random pixels."""
    side = 580
    Image.frombytes("RGB", (side, side), random.Random(4).randbytes(3 * side * side)).save(path)
    return path


def slow(visit, bytes_per_second):
    session = visit.context.new_cdp_session(visit.page)
    session.send("Network.enable")
    conditions = {
        "offline": False,
        "latency": 5,
        "downloadThroughput": -1,
        "uploadThroughput": bytes_per_second,
    }
    session.send("Network.emulateNetworkConditions", conditions)


def test_an_upload_shows_how_far_it_is(visit, tmp_path):
    slow(visit, 400_000)
    visit.page.evaluate(
        """() => {
          globalThis.seen = [];
          const [bar, text] = ["#upload-bar", "#upload-text"].map((id) =>
            document.querySelector(id));
          const { dataset } = document.body;
          const note = () => dataset.state === "uploading" &&
            seen.push([Number(dataset.progress), bar.value, text.innerText]);
          new MutationObserver(note).observe(document.body, { attributes: true });
        }"""
    )
    visit.open(noise(tmp_path / "noise.png"))
    seen = visit.page.evaluate("seen")
    told = [progress for progress, _, _ in seen]
    assert told == sorted(told)
    between = [(progress, bar, words) for progress, bar, words in seen if 0 < progress < 100]
    assert len({progress for progress, _, _ in between}) >= 2, seen
    for progress, bar, words in between:
        assert abs(bar - progress) <= 1 and re.search(rf"noise\.png.* {progress} %", words), (
            progress,
            bar,
            words,
        )


def test_an_upload_is_cancelled(visit, tmp_path):
    visit.expects("ERR_ABORTED")
    slow(visit, 20_000)
    visit.page.set_input_files("#file", noise(tmp_path / "noise.png"))
    visit.body("[data-state=uploading]")
    visit.page.click("#upload-cancel")
    data = visit.body("[data-state=empty]").data
    assert (data["problem"], data["session"]) == ("", "")
