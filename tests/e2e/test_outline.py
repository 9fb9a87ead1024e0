"""Handles that act inside the outline of a cut-out, and the choosers of methods and metrics."""

import base64
import io
import json
import re

import pytest
from PIL import Image, ImageChops, ImageDraw

from support import near

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


def toasted(visit, words):
    visit.page.wait_for_selector(f"#toast.seen:text-matches('{words}')")


def test_a_pin_near_the_outline_is_moved_inside(visit, tmp_path):
    """Within a finger's width it can only mean what is inside; q follows, so that nothing bends."""
    stood(visit, tmp_path / "legs.png")
    before = drawn(visit)
    visit.click(127, 250)
    toasted(visit, "nearest place inside")
    visit.body("[data-handles='5']")
    assert drawn(visit).tobytes() == before.tobytes()
    assert near(visit.posed(4), (119.5, 250.5), 1) and visit.warp()["p"][4] == visit.warp()["q"][4]
    # The same in a pose, where the leg is somewhere else.
    visit.drag(RIGHT, (280, 240))
    visit.ready()
    visit.click(10, 200)
    visit.body("[data-handles='6']").ready()
    assert near(visit.warp()["p"][5], (20.5, 200.5), 2)


def test_a_pin_far_from_the_outline_is_refused_with_a_sentence(visit, tmp_path):
    stood(visit, tmp_path / "legs.png")
    visit.click(150, 280)
    toasted(visit, "put a handle on what the picture shows")
    assert visit.ready()["handles"] == "4"
    visit.page.click("#tool-line")
    visit.drag((60, 200), (240, 200))
    toasted(visit, "draw a path along what the picture shows")
    assert visit.ready()["handles"] == "4"
    visit.drag((60, 60), (240, 60))
    assert visit.body("[data-handles='5']").ready()["problem"] == ""
    # The button means a handle in any case, wherever the middle of the view is.
    visit.page.click("#tool-point")
    visit.page.click("#add")
    assert visit.body("[data-handles='6']").ready()["problem"] == ""


def test_a_path_that_is_refused_stays_a_draft(visit, tmp_path):
    """It may be many taps: undo takes back those that are wrong."""
    stood(visit, tmp_path / "legs.png")
    visit.page.click("#tool-path")
    taps = [(40, 180), (60, 150), (80, 60), (200, 60), (150, 280)]
    for place in taps:
        visit.click(*place)
    visit.page.click("#draft-finish")
    toasted(visit, "put a handle on what the picture shows")
    assert (visit["draft"], visit["handles"]) == ("5", "4")
    visit.page.click("#undo")
    visit.click(60, 200)
    visit.page.click("#draft-finish")
    toasted(visit, "draw a path along what the picture shows")
    assert (visit["draft"], visit["handles"]) == ("5", "4")
    visit.keys("Control+z")
    assert visit["draft"] == "4"
    visit.page.click("#draft-finish")
    assert visit.body("[data-handles='5'][data-draft='0']").ready()["problem"] == ""
    assert len(visit.warp()["p"][4]) == 4


@pytest.mark.parametrize("size", [(5000, 4000), (4000, 5000), (6001, 4001), (4096, 4096)])
def test_the_copy_has_no_more_pixels_than_any_canvas(visit, size):
    """With one more than 2 ** 24, a canvas of some browsers is blank, and nothing is inside."""
    pixels, wide = visit.page.evaluate(
        """(size) => {
          const { prototype } = CanvasRenderingContext2D;
          const read = prototype.getImageData;
          let most = 0;
          prototype.getImageData = function (...box) {
            most = Math.max(most, this.canvas.width * this.canvas.height);
            return read.apply(this, box);
          };
          return import("/page/outline.js").then(({ insideOf }) => {
            const original = Object.assign(document.createElement("canvas"), { id: "original" });
            [original.width, original.height] = [50, 40];
            original.getContext("2d").fillRect(25, 0, 25, 40);
            const stage = document.createElement("div");
            stage.append(original);
            // With a region, whose mask is a canvas too.
            const places = [[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]];
            const region = [{ kind: "lasso", removes: false, places }];
            const own = { metric: "geodesic", method: "rigid", handles: [], region, feather: 8 };
            const inside = insideOf({ stage, size }, own);
            return [most, inside.placeFor([size[0] / 2 - 40, 30])[0] / size[0]];
          });
        }""",
        size,
    )
    assert 2**24 * 0.999 < pixels <= 2**24 and abs(wide - 0.5) < 0.005, (pixels, wide)


def test_the_nearest_place_is_the_nearest_one(visit):
    """Of all pixels that are inside, from places within and beside a picture of odd sides."""
    worst = visit.page.evaluate("""import("/page/outline.js").then(({ Inside }) => {
      let seed = 1;
      const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
      let worst = 0;
      for (const [width, height, share, scale] of [
        [131, 77, 0.0005, 1], [131, 77, 0.01, 0.5], [40, 203, 0.002, 1], [7, 5, 0.3, 1],
        [64, 64, 0, 1],
      ]) {
        const alpha = Uint8Array.from({ length: width * height }, () => 255 * (random() < share));
        const inside = new Inside(alpha, width, scale, 127);
        for (let n = 0; n < 300; n++) {
          const place = [width, height].map((side) => (side * (1.6 * random() - 0.3)) / scale);
          const away = (u, v) => {
            const [x, y] = place.map((c) => c * scale);
            const [a, b] = [Math.max(0, u - x, x - u - 1), Math.max(0, v - y, y - v - 1)];
            return Math.hypot(a, b) / scale;
          };
          let least = Infinity;
          for (let k = 0; k < alpha.length; k++)
            if (alpha[k]) least = Math.min(least, away(k % width, Math.floor(k / width)));
          for (const reach of [Infinity, 20]) {
            const found = inside.placeFor(place, reach);
            const is = !found ? Infinity : found === place ? "same"
              : away(...found.map((c) => Math.floor(c * scale)));
            const should = least <= 3 ? "same" : least > reach ? Infinity : least;
            if (is !== should) worst = Math.max(worst, Math.abs(is - should) || 1e9);
          }
        }
      }
      return worst;
    })""")
    assert worst < 1e-9, worst


def lassos(visit):
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((10, 10), (226, 10), (226, 295), (10, 295))
    visit.page.click("label:has(#tool-point)")


def acts_inside(visit):
    visit.page.click("label:has(#metric-geodesic)")


def is_a_puppet(visit):
    visit.page.click("label:has(#method-arap)")


# What makes handles stand beside the outline that did not, or did without harm.
LATER = {
    "region": (None, lassos, [[60, 270], [236, 270], [60, 60], [234, 60]]),
    "metric": ("euclidean", acts_inside, [[60, 270], [172, 200], [129, 250]]),
    "method": ("euclidean", is_a_puppet, [[60, 270], [172, 200], [129, 250]]),
}


@pytest.mark.parametrize("how", LATER)
@pytest.mark.parametrize("way", ["Move inside", "Act across gaps", "undo"])
def test_what_comes_after_the_pins_leaves_a_way(visit, tmp_path, how, way):
    metric, act, p = LATER[how]
    q = [[x + 4, y - 6] for x, y in p]
    visit.open(legs(tmp_path / "legs.png"))
    value = {"p": p, "q": q, "metric": metric or "geodesic"}
    (tmp_path / "pins.json").write_text(json.dumps(value))
    visit.page.set_input_files("#file", tmp_path / "pins.json")
    visit.body(f"[data-handles='{len(p)}']").ready()
    visit.expects("422")
    act(visit)
    visit.body("[data-problem=outside_mask]")
    # Every handle that is outside is named, not the first one alone.
    assert re.match(r"Handles 2 and \d:", visit.text("problem-detail"))
    assert visit.page.locator("#handles [data-fault='']").count() == 2
    if way == "undo":
        visit.page.click("#undo")
        visit.ready()
        assert visit.warp()["p"] == p
        return
    button = visit.page.get_by_role("button", name=way)
    assert button.is_visible()
    button.click()
    visit.ready()
    warp = visit.warp()
    if way == "Act across gaps":
        assert warp["p"] == p and "metric" not in warp and warp["method"] == "rigid"
        return
    source = Image.open(tmp_path / "legs.png").getchannel("A")
    for (x, y), (u, v), was in zip(warp["p"], warp["q"], p):
        assert source.getpixel((int(x), int(y))) and near((u - x, v - y), (4, -6), 0.02)
        assert [x, y] == was or not source.getpixel(tuple(was)) or how == "region"
    assert warp["p"][0] == p[0]
    # One step takes it back, and what was said comes again.
    visit.page.click("#undo")
    visit.body("[data-problem=outside_mask]")


@pytest.mark.parametrize("name", ["points.csv", "horse.pts", "face.tps"])
def test_landmarks_beside_the_outline_are_named_and_moved_inside(visit, tmp_path, name):
    places = [(60, 60), (240, 60), (60, 270), (126, 200), (174, 230)]
    text = {
        "points.csv": "x,y\n" + "".join(f"{x},{y}\n" for x, y in places),
        "horse.pts": f"version: 1\nn_points: {len(places)}\n{{\n"
        + "".join(f"{x} {y}\n" for x, y in places)
        + "}\n",
        # Its origin is the lower left corner.
        "face.tps": f"LM={len(places)}\n" + "".join(f"{x} {300 - y}\n" for x, y in places),
    }[name]
    visit.open(legs(tmp_path / "legs.png"))
    visit.expects("422")
    (tmp_path / name).write_text(text)
    visit.page.set_input_files("#file", tmp_path / name)
    visit.body("[data-handles='5'][data-problem=outside_mask]")
    assert visit.text("problem-title") == "2 handles lie beside the outline"
    assert visit.text("problem-detail").startswith("Handles 4 and 5:")
    assert visit.page.is_checked("#metric-geodesic")
    visit.page.click("#problem-action")
    toasted(visit, "2 handles moved to the nearest places inside")
    visit.ready()
    warp = visit.warp()
    assert warp["metric"] == "geodesic" and len(warp["p"]) == 5
    assert warp["p"][3][0] < 120 and warp["p"][4][0] > 180


def test_a_line_that_leaves_the_outline_may_act_across_gaps(visit, tmp_path):
    visit.open(legs(tmp_path / "legs.png"))
    visit.expects("422")
    value = {"p": [[[60, 200], [240, 200]]], "metric": "geodesic"}
    (tmp_path / "line.json").write_text(json.dumps(value))
    visit.page.set_input_files("#file", tmp_path / "line.json")
    visit.body("[data-problem=outside_mask]")
    assert visit.text("problem-action") == "Act across gaps"
    assert visit.text("problem-other") == "Delete marked"
    visit.page.click("#problem-action")
    visit.ready()
    visit.page.click("#undo")
    visit.body("[data-problem=outside_mask]")
    visit.page.click("#problem-other")
    assert visit.ready()["handles"] == "0"


def test_handles_far_from_the_region_are_not_heaped_at_its_edge(visit, tmp_path):
    """A region around one leg: the pins elsewhere stay where they are, or go."""
    stood(visit, tmp_path / "legs.png")
    visit.drag(RIGHT, (260, 240))
    visit.ready()
    warp = visit.warp()
    visit.expects("422")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((170, 130), (295, 130), (295, 295), (170, 295))
    visit.body("[data-problem=outside_mask]")
    assert visit.text("problem-title") == "3 handles lie beside the outline"
    assert visit.text("problem-action") == "Act across gaps"
    visit.page.click("#problem-action")
    visit.ready()
    assert visit.warp()["p"] == warp["p"] and visit.warp()["q"] == warp["q"]
    visit.page.click("#undo")
    visit.body("[data-problem=outside_mask]")
    visit.page.click("#problem-other")
    visit.ready()
    assert visit.warp()["p"] == [warp["p"][1]]


def test_a_project_with_handles_beside_the_outline_is_opened(visits, tmp_path):
    """What a page can save, it can open, with the same way out."""
    visit = visits()
    visit.open(legs(tmp_path / "legs.png"))
    visit.expects("422")
    (tmp_path / "points.csv").write_text("x,y\n60,60\n126,200\n")
    visit.page.set_input_files("#file", tmp_path / "points.csv")
    visit.body("[data-handles='2'][data-problem=outside_mask]")
    name, saved = visit.saved("save-project")
    (tmp_path / name).write_bytes(saved)
    other = visits()
    other.expects("422")
    other.page.set_input_files("#file", tmp_path / name)
    other.body("[data-handles='2'][data-problem=outside_mask]")
    other.page.click("#problem-action")
    other.ready()
    # And a reload of a page that says so.
    visit.page.reload()
    visit.body("[data-handles='2'][data-problem=outside_mask]")
    visit.page.click("#problem-action")
    visit.ready()


def test_handles_and_region_change_together(visit, tmp_path):
    """Neither the old handles in the new region nor the new ones in the old one are inside."""
    visit.open(legs(tmp_path / "legs.png"))
    for k, (pin, box) in enumerate([(LEFT, (10, 10, 140, 295)), (RIGHT, (160, 10, 295, 295))]):
        mask = io.BytesIO()
        region = Image.new("L", (300, 300))
        ImageDraw.Draw(region).rectangle(box, fill=255)
        region.save(mask, "PNG")
        value = {
            "p": [pin, [pin[0], 60]],
            "metric": "geodesic",
            "region": base64.b64encode(mask.getvalue()).decode(),
        }
        (tmp_path / f"{k}.json").write_text(json.dumps(value))
        visit.page.set_input_files("#file", tmp_path / f"{k}.json")
        visit.body("[data-handles='2']").ready()
        assert visit.warp()["p"][0] == list(pin)
    visit.page.click("#undo")
    visit.ready()
    assert visit.warp()["p"][0] == list(LEFT)


def test_the_border_of_a_cut_out_is_not_pinned(visit, tmp_path):
    visit.expects("422")  # a puppet has no table of coefficients
    visit.open(legs(tmp_path / "legs.png"))
    for method in ("rigid", "arap"):
        visit.page.click(f"label:has(#method-{method})")
        visit.ready()
        assert visit.page.locator("#pin-border").is_disabled()
    visit.page.click("label:has(#method-rigid)")
    visit.page.click("label:has(#metric-euclidean)")
    visit.ready()
    assert visit.page.locator("#pin-border").is_enabled()


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
