"""A cut-out on a phone, from the file to a project that another phone opens, by touch alone."""

import io
import os

import pytest
from PIL import Image

from support import Fingers, near

SIZES = {"small": (360, 640), "landscape": (844, 390), "portrait": (390, 844), "large": (430, 932)}
# The narrowest and the lowest; the others in the long form.
TRIED = list(SIZES)[: None if os.environ.get("MLSWARP_TESTS_FULL") == "1" else 2]

# Words that are cut off, and controls that are not in the window as a whole.
CUT = """() => [...document.querySelectorAll(
    "header *, .bar *, #problem *, #toast, dialog[open] *")]
  .filter((node) => node.checkVisibility({ visibilityProperty: true }) && !node.closest("svg") &&
    !node.matches(".unseen, .unseen *, legend, select, option, textarea"))
  .map((node) => [node, node.getBoundingClientRect()])
  .filter(([node, box]) => box.width && (box.left < -0.5 || box.right > innerWidth + 0.5 ||
    (!node.children.length && node.textContent.trim() && node.scrollWidth > node.clientWidth + 1 &&
      getComputedStyle(node).display !== "inline")))
  .map(([node]) => node.id || node.outerHTML.slice(0, 80))"""


def phone(visits, way):
    width, height = SIZES[way]
    return visits(
        viewport={"width": width, "height": height},
        has_touch=True,
        is_mobile=True,
        device_scale_factor=3,
    )


def looks(visit, name):
    assert visit.page.evaluate(CUT) == [], name
    visit.keep(f"phone-{name}")


@pytest.fixture
def horse(visits, server, tmp_path):
    """A cut-out of 640 by 525 px."""
    image = Image.open(io.BytesIO(server.ask("GET", "/page/horse.webp").body))
    image.convert("RGBA").save(tmp_path / "horse.png")
    return tmp_path / "horse.png"


@pytest.mark.parametrize("way", TRIED)
def test_a_cut_out_is_bent_and_shared_by_touch(visits, horse, tmp_path, way):
    visit = phone(visits, way)
    fingers, page = Fingers(visit), visit.page
    with page.expect_file_chooser() as chooser:
        page.tap("#pick")
    chooser.value.set_files(horse)
    visit.body("[data-state=ready]")
    looks(visit, f"{way}-open")
    # On the back, the belly, the chest and two hooves; the last one just beside it.
    for k, place in enumerate([(200, 140), (240, 280), (384, 264), (440, 460), (215, 478)]):
        fingers.tap(*visit.at(*place))
        visit.body(f"[data-handles='{k + 1}']")
    assert visit.ready()["problem"] == ""
    looks(visit, f"{way}-pins")
    # Where nothing is near, a finger makes nothing, and is told why.
    fingers.tap(*visit.at(330, 460))
    page.wait_for_selector("#toast.seen:text-matches('put a handle on what')")
    assert visit.ready()["handles"] == "5"
    looks(visit, f"{way}-beside")
    before = visit.posed(4)
    spot = visit.at(*before)
    fingers.put(a=spot)
    fingers.move(a=(spot[0] + 40, spot[1] - 30))
    fingers.lift()
    visit.ready()
    assert not near(visit.posed(4), before, 10)
    looks(visit, f"{way}-bent")
    # A region around the hind leg that is bent: what is far from it leaves a way.
    visit.expects("422")
    page.tap("label:has(#tool-lasso)")
    corners = [visit.at(*place) for place in [(130, 250), (270, 250), (270, 520), (130, 520)]]
    fingers.put(a=corners[0])
    for corner in corners[1:]:
        fingers.move(a=corner)
    fingers.lift()
    visit.body("[data-problem=outside_mask]")
    assert not page.locator("#toast.seen").count()
    looks(visit, f"{way}-region")
    page.tap("#problem-action")
    page.tap("label:has(#tool-point)")
    assert visit.body("[data-region='1']").ready()["handles"] == "5"
    page.tap("#panel-toggle")
    page.locator("#holes").scroll_into_view_if_needed()
    assert page.input_value("#holes") == "transparent"
    looks(visit, f"{way}-holes")
    page.tap("#panel-toggle")
    page.tap("#export-open")
    page.wait_for_selector("#export-result:text-matches('640 × 525 px')")
    looks(visit, f"{way}-export")
    with page.expect_download() as download:
        page.tap("#export-save")
    drawn = Image.open(download.value.path())
    assert drawn.size == (640, 525) and drawn.mode == "RGBA"
    page.tap("#panel-toggle")
    page.locator("#copy-link").scroll_into_view_if_needed()
    page.tap("#copy-link")
    page.wait_for_selector("#link-note:text-matches('It works until')")
    looks(visit, f"{way}-link")
    link = page.evaluate("navigator.clipboard.readText()")
    with page.expect_download() as download:
        page.tap("#save-project")
    download.value.save_as(tmp_path / "horse-project.json")
    other = phone(visits, way)
    other.page.set_input_files("#file", tmp_path / "horse-project.json")
    other.body("[data-handles='5'][data-region='1']").ready()
    looks(other, f"{way}-project")
    guest = phone(visits, way)
    guest.page.goto(link)
    guest.page.reload()
    guest.body("[data-handles='5'][data-region='1']").ready()
    looks(guest, f"{way}-guest")
