"""Many handles: a canvas draws them, and each keeps its element, name, focus and keys."""

import json

import pytest

from support import near

COUNT = 500
P = [[20 + 15 * (n % 25), 15 + 13.5 * (n // 25)] for n in range(COUNT)]


@pytest.fixture
def many(opened):
    value = {"p": P, "q": [[x + n % 3, y] for n, (x, y) in enumerate(P)]}
    opened.page.set_input_files(
        "#file",
        {"name": "many.json", "mimeType": "application/json", "buffer": json.dumps(value).encode()},
    )
    opened.body(f"[data-handles='{COUNT}']").ready()
    return opened


def drawn_by_svg(visit):
    """Indices of the handles whose dots the SVG draws."""
    return visit.page.evaluate(
        "[...document.querySelectorAll('#handles .dot')].filter((dot) => "
        "dot.checkVisibility()).map((dot) => Number(dot.parentNode.dataset.handle))"
    )


def is_blue(visit, canvas, x, y):
    """Whether a canvas over the stage is blue at a position of the page."""
    return visit.page.evaluate(
        """([id, x, y]) => {
          const canvas = document.getElementById(id);
          if (canvas.hidden) return false;
          const { left, top } = canvas.getBoundingClientRect();
          const [u, v] = [x - left, y - top].map((c) => c * devicePixelRatio);
          const [r, g, b, a] = canvas.getContext("2d").getImageData(u, v, 1, 1).data;
          return a > 200 && b > 200 && r < 120;
        }""",
        [canvas, x, y],
    )


def test_handles_that_are_not_selected_are_on_the_canvas(many):
    assert drawn_by_svg(many) == []
    for index in (0, 77, COUNT - 1):
        assert is_blue(many, "marks", *many.at(*many.posed(index))), index
    assert many.page.locator("#handle-77").get_attribute("aria-label").startswith("Point 78 at ")
    # By keys: focus, selection and movement.
    many.page.focus("#handle-77")
    many.keys("Shift+Tab", "Tab")
    assert many.page.evaluate("document.activeElement.id") == "handle-77" and drawn_by_svg(
        many
    ) == [77]
    many.keys("Enter", "ArrowRight")
    many.ready()
    assert many["selected"] == "1" and near(many.posed(77), (P[77][0] + 77 % 3 + 1, P[77][1]), 0.01)
    many.page.evaluate("document.activeElement.blur()")
    assert drawn_by_svg(many) == [77] and not is_blue(many, "marks", *many.at(*many.posed(77)))
    many.keys("Escape")
    assert drawn_by_svg(many) == [] and is_blue(many, "marks", *many.at(*many.posed(77)))


def test_a_drag_is_on_a_canvas_of_its_own(many):
    x, y = many.posed(312)
    many.press((x, y), (x + 8, y + 5))
    many.body("[data-moving=true]")
    assert many.page.evaluate("getComputedStyle(document.querySelector('#handles')).opacity") == "0"
    assert near(many.posed(312), (x + 8, y + 5), 0.6), "what is told follows"
    px, py = many.at(x + 8, y + 5)
    # A selected one is white with a blue rim.
    many.page.wait_for_selector("#moving", state="visible")
    assert is_blue(many, "moving", px - 7, py) and not is_blue(many, "moving", px, py)
    assert not is_blue(many, "marks", px - 7, py)
    many.page.mouse.up()
    many.ready()
    assert not many.page.locator("#moving").is_visible() and drawn_by_svg(many) == [312]
    box = many.page.locator("#handle-312 .dot").bounding_box()
    assert near((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2), (px, py), 1)


def test_a_large_selection_is_on_the_canvas_too(many):
    many.page.click("#select-all")
    many.body(f"[data-selected='{COUNT}']")
    assert drawn_by_svg(many) == []
    x, y = many.at(*many.posed(100))
    assert not is_blue(many, "marks", x, y) and is_blue(many, "marks", x - 7.5, y)
