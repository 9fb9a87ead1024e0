"""Accessibility: no serious findings of axe in any state, large enough targets, announcements for
screen readers."""

import io
import json
import re
from pathlib import Path

import axe_playwright_python
import pytest
from PIL import Image

from support import GREEN, RED, Fingers, crossed, tell

AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js").read_text()
NARROW = {
    "viewport": {"width": 360, "height": 740},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}
THEMES = ["light", "dark"]
# The rule about visible labels is experimental, and off unless it is named.
RULES = {
    "resultTypes": ["violations", "incomplete"],
    "rules": {"label-content-name-mismatch": {"enabled": True}},
}


PROBLEMS = re.findall(
    r"^## (\w+)$", (Path(__file__).parents[2] / "api" / "problems.md").read_text(), re.MULTILINE
)


def faults(visit):
    """What axe calls serious or critical, and what it names."""
    visit.page.evaluate(AXE)
    found = visit.page.evaluate("(options) => axe.run(document, options)", RULES)
    assert len(found["passes"]) > 10, "axe has looked at nothing"
    return [
        f"{fault['id']} ({fault['impact']}): {node['target']} {node['html'][:120]}"
        for fault in found["violations"]
        if fault["impact"] in ("serious", "critical")
        for node in fault["nodes"]
    ]


def empty(visit):
    pass


def ready(visit):
    visit.sample("portrait")


def selected(visit):
    visit.sample("cat")
    visit.page.click("#select-all")
    visit.page.wait_for_selector("#selection")
    visit.page.click("#mesh")


def pinned(visit):
    visit.sample("cat")
    visit.click(60, 60)
    visit.body("[data-selected='1']").ready()


def folding(visit):
    visit.sample("cat")
    visit.page.select_option("#grid-size", "10")
    visit.page.fill("#q-0-0-x", "400")
    visit.page.keyboard.press("Enter")
    assert int(visit.ready()["folds"]) > 0


def refused(visit):
    visit.expects("422")
    visit.sample("cat")
    visit.page.click("label:has(#tool-line)")
    visit.drag((100, 150), (300, 150))
    last = int(visit.ready()["handles"]) - 1
    for vertex in (0, 1):
        for axis, number in zip("xy", (100, 150)):
            visit.page.fill(f"#p-{last}-{vertex}-{axis}", str(number))
            visit.page.keyboard.press("Enter")
    visit.body("[data-problem=degenerate_line]")


def comparing(visit):
    visit.sample("rocket")
    visit.page.click("#compare")


def drawing(visit):
    visit.sample("rocket")
    visit.page.click("label:has(#tool-path)")
    visit.click(100, 60)
    visit.click(200, 60)
    visit.body("[data-draft='2']")


def exporting(visit):
    visit.sample("rocket")
    visit.page.click("#export-open")
    visit.page.click("label:has(#export-jpeg)")
    visit.page.fill("#export-width", "0")
    assert visit.page.locator("#export-problem").is_visible()


def animating(visit):
    visit.sample("rocket")
    visit.page.click("#export-open")
    visit.page.click("label:has(#export-animation)")
    visit.page.fill("#export-frames", "1")
    assert visit.page.locator("#export-problem").is_visible()


def outlining(visit):
    visit.sample("rocket")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((100, 60), (200, 60), (200, 200), (100, 200))
    visit.page.click("label:has(#tool-brush)")
    visit.body("[data-region='1']").ready()


def waiting(visit):
    file = b'{"p": [[1, 2]]}'
    visit.page.set_input_files(
        "#file", {"name": "one.json", "mimeType": "application/json", "buffer": file}
    )
    visit.page.wait_for_selector("#waiting-drop")
    visit.page.set_input_files(
        "#file", {"name": "broken.json", "mimeType": "application/json", "buffer": file[:-1]}
    )
    visit.body("[data-problem=bad_handles_file]")


def told(visit):
    """Landmark files, a file that is not used, annotations and what is offered for holes."""
    visit.sample("rocket")
    places = ["1,2\n200,100\n", "5,6\n260,120\n"]
    square = {"type": "Polygon", "coordinates": [[[100, 100], [200, 100], [200, 200], [100, 100]]]}
    files = [
        ("a.csv", "text/csv", places[0].encode()),
        ("b.csv", "text/csv", places[1].encode()),
        ("c.csv", "text/csv", b"1,2\n"),
        ("d.geojson", "", json.dumps(square).encode()),
    ]
    tell(visit, ["dragover", "drop"], *files)
    visit.body("[data-annotations=exact]")
    visit.page.click("label:has(#tool-lasso)")
    visit.drag((100, 60), (200, 60), (200, 200), (100, 200))
    visit.page.click("label:has(#tool-point)")
    visit.page.wait_for_selector("#holes-hint:not([hidden])", state="attached")
    visit.ready()


def help(visit):
    visit.sample("rocket")
    visit.page.click("#help-open")


def blending(visit):
    """The average of two pictures, and a third one without landmarks."""
    files = [(f"{name}.csv", "text/csv", b"x,y\n60,60\n240,70\n150,150\n") for name in "ab"]
    for name, colour in (("a", "navy"), ("b", "olive"), ("c", "teal")):
        file = io.BytesIO()
        Image.new("RGB", (300, 200), colour).save(file, "PNG")
        files.append((f"{name}.png", "image/png", file.getvalue()))
    visit.page.click("#blend-open")
    tell(visit, ["dragover", "drop"], *files)
    visit.body("[data-blend=ready]")
    visit.page.select_option("#blend-file", "gif")


def choosing(visit):
    """One of many sets of landmarks, more than are listed."""
    visit.expects("422")
    visit.sample("rocket")
    wings = "".join(f"LM=1\n{k} 100\nIMAGE=wing_{k}.jpg\n" for k in range(1100)).encode()
    tell(visit, ["dragover", "drop"], ("wings.tps", "", wings))
    visit.page.wait_for_selector("#item-other:visible")


def beside(visit):
    """Landmarks outside of the outline."""
    visit.expects("422")
    visit.sample("horse")
    tell(visit, ["dragover", "drop"], ("a.csv", "text/csv", b"x,y\n5,5\n400,300\n"))
    visit.body("[data-problem=outside_mask]")


STATES = [
    empty,
    ready,
    selected,
    folding,
    refused,
    comparing,
    drawing,
    outlining,
    exporting,
    animating,
    waiting,
    told,
    help,
    blending,
    choosing,
    beside,
]


@pytest.mark.parametrize("state, theme", crossed(STATES, THEMES))
def test_axe_finds_nothing_serious(visits, state, theme):
    visit = visits(color_scheme=theme)
    state(visit)
    visit.keep(f"axe-{state.__name__}-{theme}")
    assert not faults(visit)


@pytest.mark.parametrize(
    "state, theme",
    crossed(
        [
            empty,
            ready,
            outlining,
            exporting,
            animating,
            waiting,
            told,
            blending,
            choosing,
            beside,
        ],
        THEMES,
    ),
)
def test_axe_finds_nothing_serious_on_a_narrow_screen(visits, state, theme):
    visit = visits(color_scheme=theme, **NARROW)
    state(visit)
    visit.keep(f"axe-narrow-{state.__name__}-{theme}")
    assert not faults(visit)
    if state is ready:
        visit.page.tap("#panel-toggle")
        visit.page.wait_for_selector("#method-rigid", state="attached")
        visit.keep(f"axe-narrow-panel-{theme}")
        assert not faults(visit)


@pytest.mark.parametrize("options", [{}, NARROW])
@pytest.mark.parametrize("state", [empty, ready])
def test_a_page_has_one_heading_of_the_first_level(visits, state, options):
    visit = visits(**options)
    state(visit)
    headings = visit.page.get_by_role("heading", level=1)
    assert headings.count() == 1 and "mlswarp" in headings.first.aria_snapshot()


@pytest.mark.parametrize("options", [{}, NARROW])
def test_the_pages_of_problems_are_accessible(visits, options):
    """Every page of a problem: code that is scrolled can be reached by keys."""
    visit = visits(**options)
    codes = [name for name in PROBLEMS if options or name in PROBLEMS[:3]]
    for code in codes:
        visit.page.goto(f"{visit.server.address}/problems/{code}")
        assert visit.page.locator("pre:not([tabindex='0'])").count() == 0, code
        visit.page.evaluate(AXE)
        found = visit.page.evaluate("(options) => axe.run(document, options)", RULES)["violations"]
        assert [fault["id"] for fault in found] == [], code


def test_the_switch_chooses_the_other_theme(visits):
    visit = visits(color_scheme="light")
    ready(visit)
    ground = "getComputedStyle(document.body).backgroundColor"
    light = visit.page.evaluate(ground)
    visit.page.click("#theme")
    visit.page.click("#theme")
    visit.body("[data-theme=dark]")
    assert visit.page.evaluate(ground) != light
    assert not faults(visit)


# A line as a whole is as wide as it is long; its places are what is measured.
SMALL = """(least) => [...document.querySelectorAll(
    "button, input:not([type=file]), select, a[href], summary, [role=button]")]
  .filter((node) => node.checkVisibility({ visibilityProperty: true, opacityProperty: true }) &&
    !node.disabled)
  .filter((node) => !["line", "path"].includes(node.dataset.kind) || node.dataset.vertex)
  .map((node) => [node.closest("label") ?? node.querySelector(".hit") ?? node, node])
  .map(([target, node]) => [target.getBoundingClientRect(), node])
  .filter(([{ width, height }]) => width < least - 0.5 || height < least - 0.5)
  .map(([{ width, height }, node]) =>
    `${node.id || node.outerHTML.slice(0, 60)}: ${width.toFixed(0)} x ${height.toFixed(0)}`)"""


@pytest.mark.parametrize(
    "state",
    [
        empty,
        selected,
        comparing,
        drawing,
        outlining,
        exporting,
        animating,
        waiting,
        told,
        choosing,
        beside,
    ],
)
def test_targets_are_large_enough_for_a_mouse(visit, state):
    state(visit)
    assert visit.page.evaluate(SMALL, 24) == []


def test_targets_are_large_enough_for_a_finger(visits):
    visit = visits(**NARROW)
    fingers = Fingers(visit)
    small = [line for line in visit.page.evaluate(SMALL, 44)]
    assert small == [], "at the start"
    visit.sample("cat")
    fingers.tap(*visit.at(60, 60))
    visit.body("[data-selected='1']")
    # Handles are taken from 22 px around (test_touch.py); everything else is a target of its own.
    small = [line for line in visit.page.evaluate(SMALL, 44) if not line.startswith("handle-")]
    assert small == []
    visit.page.tap("label:has(#tool-brush)")
    assert visit.page.evaluate(SMALL, 44) == []


@pytest.mark.parametrize(
    "width, more", [(320, {}), (360, {}), (360, {"has_touch": True, "is_mobile": True}), (768, {})]
)
@pytest.mark.parametrize(
    "state",
    [empty, ready, pinned, outlining, exporting, animating, waiting, told, choosing, beside],
)
def test_nothing_runs_out_of_the_screen(visits, state, width, more):
    visit = visits(viewport={"width": width, "height": 700}, **more)
    state(visit)
    assert visit.page.evaluate("document.scrollingElement.scrollWidth") <= width
    out = visit.page.evaluate(
        """() => [...document.querySelectorAll(
            "header *, .bar *, #drop button, #selection *, dialog[open] *, #problem *")]
          .filter((node) => node.checkVisibility() && !node.closest("svg") &&
            !node.matches(".unseen, .unseen *"))
          .map((node) => [node, node.getBoundingClientRect()])
          .filter(([, box]) => box.width && (box.left < -0.5 || box.right > innerWidth + 0.5))
          .map(([node]) => node.id || node.outerHTML.slice(0, 80))"""
    )
    assert out == []


def test_changes_are_said(opened):
    says = opened.page.locator("#says")
    assert says.get_attribute("aria-live") == "polite"
    opened.click(*RED)
    assert says.inner_text() == "Point 1 added at 100, 100"
    opened.drag(RED, (140, 130))
    assert says.inner_text() == "Point 1 at 140, 130"
    opened.page.click("#undo")
    assert says.inner_text() == "Undone"
    opened.click(*GREEN)
    opened.page.click("#remove")
    assert says.inner_text() == "1 handle deleted"


def test_every_control_has_a_name_and_the_focus_is_seen(visit):
    ready(visit)
    nameless = visit.page.evaluate(
        """() => [...document.querySelectorAll(
            "button, input, select, textarea, [role=button], [role=application]")]
          .filter((node) => node.checkVisibility())
          .filter((node) => !(node.ariaLabel || node.labels?.length || node.innerText?.trim()))
          .map((node) => node.outerHTML.slice(0, 100))"""
    )
    assert nameless == []
    # From the first to the last: wherever Tab stops, something is drawn around it.
    unseen, stops = [], 0
    visit.page.evaluate("document.activeElement.blur()")
    for _ in range(200):
        visit.keys("Tab")
        stop = visit.page.evaluate(
            """() => {
              const node = document.activeElement;
              if (node === document.body) return null;
              const parts = [node, node.closest("label"), ...node.querySelectorAll("*")];
              const styles = parts.filter(Boolean).map((part) => getComputedStyle(part));
              const outlined = (s) => s.outlineStyle !== "none" && parseFloat(s.outlineWidth) >= 2;
              const seen = styles.some((s) => outlined(s) || s.boxShadow !== "none");
              const isHandle = Boolean(node.closest("#handles"));
              const name = node.id || node.outerHTML.slice(0, 60);
              return [name, seen || isHandle, node.dataset.handle !== undefined];
            }"""
        )
        if stop is None:
            break
        stops += 1
        if not stop[1]:
            unseen.append(stop[0])
    assert stops > 30 and unseen == []


def test_nothing_moves_for_those_who_asked_for_stillness(visit):
    assert (
        visit.page.evaluate(
            "document.getAnimations().filter((a) => a.playState === 'running' && "
            "a.effect.getComputedTiming().duration > 50).length"
        )
        == 0
    )
