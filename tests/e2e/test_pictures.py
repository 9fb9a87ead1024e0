"""Screenshots of the page for review. MLSWARP_BLESS=1 updates them in `pictures/`; otherwise they
are only in the artefacts."""

import io
import os

import pytest
from PIL import Image

from support import HERE, KEPT

MOST = 400 * 1024


def portrait_with_mesh(visit):
    visit.sample("portrait")
    visit.page.click("#mesh")
    visit.page.mouse.move(0, 0)


def fold_warning(visit):
    visit.sample("cat")
    visit.page.select_option("#grid-size", "5")
    visit.page.fill("#q-4-0-x", "215")
    visit.page.keyboard.press("Enter")
    assert int(visit.ready()["folds"]) > 0
    visit.page.evaluate("document.activeElement.blur()")
    visit.keys("Escape")


def export(visit):
    visit.sample("horse")
    visit.page.click("#export-open")
    visit.page.click("label:has(#export-jpeg)")
    visit.page.wait_for_selector("#export-result:text-matches('iB$')")


def region(visit):
    visit.sample("portrait")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag(
        (180, 60), (150, 110), (170, 190), (200, 230), (260, 220), (300, 150), (300, 70), (240, 15)
    )
    visit.page.locator("#feather").fill("20")
    visit.page.click("label:has(#tool-brush)")
    visit.press((400, 60), (410, 300), steps=12)
    visit.page.wait_for_selector("#brush-at")
    visit.page.locator("#region-clear").scroll_into_view_if_needed()


def animation(visit):
    visit.sample("horse")
    visit.page.click("#export-open")
    visit.page.click("label:has(#export-animation)")


def phone(visit):
    visit.sample("portrait")


def dark(visit):
    visit.sample("rocket")
    (x, y), (u, v) = visit.posed(0, 0), visit.posed(0, 1)
    visit.click((x + u) / 2, (y + v) / 2)  # the rocket as a whole
    visit.body("[data-selected='1']")


PICTURES = {
    "empty": (lambda visit: None, {"color_scheme": "light"}),
    "portrait-mesh": (portrait_with_mesh, {"color_scheme": "light"}),
    "fold-warning": (fold_warning, {"color_scheme": "light"}),
    "export": (export, {"color_scheme": "dark"}),
    "region": (region, {"color_scheme": "light"}),
    "animation": (animation, {"color_scheme": "dark"}),
    "phone": (
        phone,
        {
            "viewport": {"width": 390, "height": 844},
            "device_scale_factor": 2,
            "has_touch": True,
            "is_mobile": True,
        },
    ),
    "dark": (dark, {"color_scheme": "dark"}),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_the_page(visits, name):
    make, options = PICTURES[name]
    visit = visits(**options)
    make(visit)
    visit.page.evaluate("document.fonts.ready")
    keep(name, Image.open(io.BytesIO(visit.page.screenshot())))


def test_the_strength_as_a_strip(visit):
    visit.sample("horse")
    shots = []
    for strength in (-1, 0, 0.5, 1, 1.5, 2):
        visit.page.locator("#strength").fill(str(strength))
        visit.ready()
        visit.page.click("#before", trial=True)  # the frame is on the screen
        shots.append(
            Image.open(
                io.BytesIO(
                    visit.page.screenshot(clip={"x": 84, "y": 52, "width": 860, "height": 748})
                )
            ).resize((430, 374))
        )
    strip = Image.new("RGB", (3 * 430, 2 * 374))
    for index, shot in enumerate(shots):
        strip.paste(shot, (index % 3 * 430, index // 3 * 374))
    keep("strength", strip)


def keep(name, shot):
    shot = shot.convert("RGB")
    shot.save(KEPT / f"{name}.png")
    colours = shot.getcolors(maxcolors=shot.width * shot.height)
    assert max(count for count, _ in colours) < 0.9 * shot.width * shot.height, "nothing is drawn"
    kept = HERE / "pictures" / f"{name}.png"
    if os.environ.get("MLSWARP_BLESS"):
        # 256 colours are enough to look at, and a fraction of the bytes.
        shot.quantize(256, kmeans=3, dither=Image.Dither.FLOYDSTEINBERG).save(kept, optimize=True)
    assert Image.open(kept).size == shot.size, (
        "the picture that is kept is of another page: MLSWARP_BLESS=1"
    )
    assert kept.stat().st_size <= MOST


def test_no_picture_is_left_over():
    assert {file.stem for file in (HERE / "pictures").iterdir()} == {*PICTURES, "strength"}
