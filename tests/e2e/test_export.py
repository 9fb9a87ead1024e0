"""The export dialog: the download and the command have the bytes that the dialog shows."""

import io
import re
import shutil
import subprocess

import pytest
from PIL import Image

from support import BLUE, BROKEN, GREEN, RED, Fingers, Server

NAMES = {"png": "PNG", "jpeg": "JPEG", "webp": "WEBP"}


@pytest.fixture
def bent(visit, picture, tmp_path):
    shutil.copy(picture, tmp_path)
    visit.open(tmp_path / picture.name)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, (140, 130))
    visit.ready()
    return visit


def shown(visit):
    """Size and bytes that the dialog shows, when the file is prepared."""
    visit.page.wait_for_selector("#export-result:text-matches('\\\\d (bytes|[KM]iB)$')")
    width, height, size, unit = re.fullmatch(
        r"(\d+) × (\d+) px, ([\d.]+) (bytes|KiB|MiB)", visit.text("export-result")
    ).groups()
    return (int(width), int(height)), float(size) * {"bytes": 1, "KiB": 1 << 10, "MiB": 1 << 20}[
        unit
    ]


def command(visit, folder):
    """Runs the copied command; returns name and bytes of its file."""
    visit.page.click("#export-curl")
    visit.page.wait_for_selector("#export-said:text-matches('copied')")
    line = visit.page.evaluate("navigator.clipboard.readText()")
    before = set(folder.iterdir())
    done = subprocess.run(
        ["sh", "-euc", line], cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and not done.stderr, (line, done.stderr)
    (made,) = set(folder.iterdir()) - before
    return made.name, made.read_bytes()


def choose(visit, **settings):
    for name, value in settings.items():
        if name == "format":
            visit.page.click(f"label:has(#export-{value})")
        elif name == "compression":
            visit.page.select_option("#export-compression", value)
        else:
            visit.page.fill(f"#export-{name}", str(value))


@pytest.mark.parametrize(
    "settings, output, size",
    [
        ({}, {}, (400, 300)),
        ({"compression": "best"}, {"compression": "best"}, (400, 300)),
        ({"width": 133}, {"width": 133}, (133, 100)),
        ({"scale": 250}, {"width": 1000}, (1000, 750)),
        ({"format": "jpeg"}, {"format": "jpeg", "quality": 85}, (400, 300)),
        (
            {"format": "jpeg", "quality": 35, "width": 200, "background": "#ff8000"},
            {"format": "jpeg", "quality": 35, "width": 200, "outside": "#ff8000ff"},
            (200, 150),
        ),
        ({"format": "webp", "scale": 50}, {"format": "webp", "width": 200}, (200, 150)),
    ],
)
def test_the_file_is_what_the_dialog_shows(bent, tmp_path, settings, output, size):
    bent.page.click("#export-open")
    choose(bent, **settings)
    told, length = shown(bent)
    assert told == size
    name, bytes = command(bent, tmp_path)
    saved_name, saved = bent.saved("export-save")
    assert saved == bytes == bent.of_server(**output).body
    image = Image.open(io.BytesIO(saved))
    format = settings.get("format", "png")
    assert image.size == size and image.format == NAMES[format]
    assert abs(length - len(saved)) <= max(1, 0.05 * 1024 if length < 100 * 1024 else 512)
    assert name == saved_name == f"discs-warped.{ {'jpeg': 'jpg'}.get(format, format) }"
    assert not bent.page.locator("#export").is_visible()


def test_a_jpeg_has_the_background_that_was_chosen(bent):
    """Drawn to the right, the picture leaves its left border: there the background is seen."""
    bent.page.click("#select-all")
    bent.keys(*["Shift+ArrowRight"] * 5)
    bent.ready()
    bent.page.click("#export-open")
    choose(bent, format="jpeg", quality=100, background="#ff8000")
    shown(bent)
    image = Image.open(io.BytesIO(bent.saved("export-save")[1]))
    assert all(abs(a - b) < 6 for a, b in zip(image.getpixel((5, 150)), (255, 128, 0)))
    # The content outside that the panel chooses is used as it is.
    bent.page.select_option("#outside", "edge")
    bent.ready()
    bent.page.click("#export-open")
    shown(bent)
    assert not bent.page.locator("#export-background").is_visible() and "white" in bent.text(
        "export-background-note"
    )
    image = Image.open(io.BytesIO(bent.saved("export-save")[1]))
    assert all(abs(a - 200) < 6 for a in image.getpixel((5, 150)))


def test_the_choices_are_remembered_and_the_quick_download_is_not_affected(bent):
    png = bent.saved("download")[1]
    bent.page.click("#export-open")
    choose(bent, format="jpeg", quality=40, scale=50)
    shown(bent)
    bent.page.click("#export-close")
    assert bent.saved("download")[1] == png
    bent.page.reload()
    bent.ready()
    bent.page.click("#export-open")
    assert shown(bent)[0] == (200, 150)
    assert bent.page.locator("#export-jpeg").is_checked()
    assert (
        bent.page.locator("#export-quality").input_value() == "40"
        and bent.page.locator("#export-scale").input_value() == "50"
    )


@pytest.mark.parametrize("width", ["", "0", "-3", "12.5", "8165", "99999999"])
def test_a_width_that_the_server_would_reject_is_not_sent(bent, width):
    asked = []
    bent.page.click("#export-open")
    shown(bent)
    bent.page.on("request", lambda request: asked.append(request.url))
    bent.page.fill("#export-width", width)
    assert bent.text("export-problem") == "Enter a width of 1 to 8164 px."
    bent.page.click("#export-save")
    assert bent.page.locator("#export").is_visible() and bent.text("export-result") == ""
    bent.page.wait_for_timeout(500)
    assert not asked
    bent.page.fill("#export-width", "40")
    assert shown(bent)[0] == (40, 30) and not bent.page.locator("#export-problem").is_visible()


def test_the_largest_width_is_the_servers(visits, picture):
    server = Server("--max-image-pixels", "200000", "--max-image-side", "600")
    try:
        visit = visits(server).open(picture)
        visit.page.click("#export-open")
        shown(visit)
        widest = int(visit.page.locator("#export-width").get_attribute("max"))
        statuses = [
            server.ask(
                "POST", f"/sessions/{visit['session']}/warp", {"q": [], "output": {"width": width}}
            ).status
            for width in (widest, widest + 1)
        ]
        assert statuses == [200, 413]
        visit.page.fill("#export-width", str(widest))
        assert shown(visit)[0][0] == widest
    finally:
        server.stop()


def test_by_keys_alone(bent):
    bent.page.focus("#export-open")
    bent.keys("Enter")
    bent.page.wait_for_selector("#export[open]")
    inside = "document.querySelector('#export').contains(document.activeElement)"
    assert bent.page.evaluate(inside)
    bent.keys("Escape")
    assert (
        not bent.page.locator("#export").is_visible()
        and bent.page.evaluate("document.activeElement.id") == "export-open"
    )
    bent.page.focus("#stage")
    bent.keys("e")
    for _ in range(3):
        if bent.page.evaluate("document.activeElement.name") == "export-format":
            break
        bent.keys("Tab")
    bent.keys("ArrowRight")
    assert bent.page.locator("#export-jpeg").is_checked()
    bent.keys("Tab", "Control+a", *"320")
    assert bent.text("export-height") == "× 240 px"
    shown(bent)
    with bent.page.expect_download() as download:
        bent.keys("Enter")
    assert download.value.suggested_filename == "discs-warped.jpg"
    assert Image.open(download.value.path()).size == (320, 240)


def test_by_fingers(visits, picture):
    phone = visits(
        viewport={"width": 390, "height": 780},
        has_touch=True,
        is_mobile=True,
        device_scale_factor=2,
    ).open(picture)
    fingers = Fingers(phone)

    def tap(selector):
        box = phone.page.locator(selector).bounding_box()
        fingers.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    tap("#export-open")
    tap("label:has(#export-webp)")
    shown(phone)
    with phone.page.expect_download() as download:
        tap("#export-save")
    assert Image.open(download.value.path()).format == "WEBP"


def test_a_problem_is_shown_in_the_dialog(visits, picture):
    server = Server()
    try:
        visit = visits(server).open(picture)
        visit.expects("404", *BROKEN)
        server.kill()
        visit.page.click("#export-open")
        choose(visit, format="jpeg")
        visit.page.wait_for_selector("#export-problem:text-matches('does not respond')")
        server.start()
        visit.page.click("#export-close")
        visit.click(*RED)
        visit.ready()
        visit.page.click("#export-open")
        shown(visit)
        assert not visit.page.locator("#export-problem").is_visible()
    finally:
        server.stop()


@pytest.mark.parametrize("typed", [False, True])
def test_a_dialog_that_opens_before_the_picture_takes_its_size(bent, typed):
    bent.drag((140, 130), (20, 130))
    bent.ready()
    with bent.without_pictures():
        bent.page.select_option("#canvas", "fit")
        bent.page.click("#export-open")
        assert bent.page.locator("#export-width").input_value() == "400"
        if typed:
            choose(bent, width=400, format="jpeg")
    size, _ = shown(bent)
    whole = bent.saved("export-save")[1]
    drawn = Image.open(io.BytesIO(whole)).size
    assert size == drawn
    assert (drawn[0] == 400) == typed
