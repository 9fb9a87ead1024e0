"""Handles that act inside the outline of a cut-out, and the choosers of methods and metrics."""

import io

import pytest
from PIL import Image, ImageChops, ImageDraw

LEFT, RIGHT = (60, 270), (240, 270)


def legs(path):
    """Two legs that join above: between them, and below them, there is nothing."""
    image = Image.new("RGBA", (300, 300), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    draw.rectangle((20, 20, 279, 119), fill=(40, 90, 200, 255))
    for left in (20, 180):
        draw.rectangle((left, 120, left + 99, 289), fill=(40, 90, 200, 255))
    for y in range(20, 290, 20):
        draw.line((20, y, 279, y), fill=(230, 200, 40, 255), width=4)
    # The lines stay on the legs.
    draw.rectangle((120, 120, 179, 299), fill=(0, 0, 0, 0))
    image.save(path)
    return path


def drawn(visit):
    visit.ready()
    return Image.open(io.BytesIO(visit.saved("download")[1])).convert("RGBA")


def change(a, b, box):
    """The largest change of a sample in a box."""
    difference = ImageChops.difference(a.crop(box), b.crop(box))
    return max(high for _, high in difference.getextrema())


def mean_change(a, b, box):
    difference = ImageChops.difference(a.crop(box), b.crop(box)).convert("L")
    histogram = difference.histogram()
    return sum(value * count for value, count in enumerate(histogram)) / sum(histogram)


def stood(visit, path):
    """Both feet and both shoulders are pinned."""
    visit.open(legs(path))
    for place in (LEFT, RIGHT, (50, 50), (250, 50)):
        visit.click(*place)
    visit.body("[data-handles='4']").ready()
    return visit


def test_a_leg_of_a_cut_out_bends_alone(visit, tmp_path):
    stood(visit, tmp_path / "legs.png")
    assert visit.page.is_checked("#metric-geodesic")
    assert "one leg bends without its neighbour" in visit.text("metric-note")
    source, foot = Image.open(tmp_path / "legs.png"), (24, 240, 116, 284)
    visit.drag(RIGHT, (280, 240))
    inside = drawn(visit)
    assert inside.tobytes() == Image.open(io.BytesIO(visit.of_server().body)).tobytes()
    visit.page.click("label:has(#metric-euclidean)")
    visit.ready()
    across = drawn(visit)
    assert change(source, inside, (190, 200, 270, 280)) > 50
    few, many = mean_change(source, inside, foot), mean_change(source, across, foot)
    assert few < many / 3, (few, many)
    visit.page.click("#undo")
    assert drawn(visit).tobytes() == inside.tobytes()


def test_the_threshold_is_a_choice(visit, tmp_path):
    stood(visit, tmp_path / "legs.png")
    visit.page.locator("#threshold").fill("0.8")
    visit.ready()
    warp = visit.warp()
    assert (warp["metric"], warp["mask"]) == ("geodesic", {"threshold": 0.8})
    visit.page.click("label:has(#metric-euclidean)")
    visit.ready()
    assert not visit.page.locator("#threshold").is_visible()
    assert "metric" not in visit.warp()


def test_a_handle_beside_the_outline_is_named(visit, tmp_path):
    stood(visit, tmp_path / "legs.png")
    visit.expects("422")
    visit.click(150, 280)
    visit.page.wait_for_selector("#problem:visible")
    assert "beside the outline" in visit.page.inner_text("#problem")
    visit.page.click("#undo")
    visit.body("[data-handles='4']").ready()


def test_a_photograph_has_no_outline(opened):
    assert not opened.page.locator("#metrics").is_visible()
    assert "metric" not in opened.warp()


def test_the_horse_bends_one_leg(visit):
    source = Image.open(io.BytesIO(visit.server.ask("GET", "/page/horse.webp").body))
    visit.sample("horse")
    assert visit.page.is_checked("#metric-geodesic") and visit.page.is_checked("#method-rigid")
    bent, source = drawn(visit), source.convert("RGBA")
    width, height = source.size
    hooves = (0, height * 575 // 656, width * 530 // 800, height)
    assert change(source, bent, (width // 2, 0, width, height)) > 100
    mean = mean_change(source, bent, hooves)
    assert mean < 2, mean
    # Where the picture has nothing, nothing folds.
    assert visit.data["folds"] == "0"
    visit.keep("horse-leg")


@pytest.mark.parametrize("width", [1280, 390])
def test_every_choice_has_a_picture_and_a_sentence(visits, tmp_path, width):
    visit = visits(viewport={"width": width, "height": 844})
    visit.open(legs(tmp_path / "legs.png"))
    for chooser in ("methods", "metrics"):
        labels = visit.page.locator(f"#{chooser} label")
        for k in range(labels.count()):
            label = labels.nth(k)
            assert label.locator("svg path").count() and label.get_attribute("title")
            assert label.inner_text().strip()
        assert visit.page.evaluate(
            "id => { const { scrollWidth, clientWidth } = document.getElementById(id);"
            " return scrollWidth <= clientWidth }",
            chooser,
        )
    names = visit.page.evaluate(
        "import('/page/methods.js').then(({ METHODS }) => METHODS.map(({ name }) => name))"
    )
    assert names == visit.page.locator("#methods input").evaluate_all(
        "all => all.map(i => i.value)"
    )
    if width < 800:
        visit.page.click("#panel-toggle")
    visit.page.locator("#metrics").scroll_into_view_if_needed()
    visit.keep(f"choosers-{width}")
