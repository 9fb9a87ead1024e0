"""Choose for me: the method that predicts each pin best from the others, and the arrows of the
residuals."""

import json

from support import PHOTOGRAPHS

# Landmarks of a face, and where an affine map takes them.
LANDMARKS = [
    (183, 108),
    (246, 106),
    (215, 140),
    (192, 165),
    (238, 164),
    (160, 60),
    (270, 60),
    (150, 150),
    (280, 150),
    (214, 195),
    (120, 240),
    (310, 240),
]
WRONG = 4


def pair(wrong=25.0):
    q = [(1.03 * x - 0.04 * y + 6, 0.05 * x + 0.97 * y - 8) for x, y in LANDMARKS]
    q[WRONG] = (q[WRONG][0] + wrong, q[WRONG][1])
    return {"p": LANDMARKS, "q": q, "method": "rigid"}


def opened_with(visit, tmp_path, warp):
    path = tmp_path / "landmarks.json"
    path.write_text(json.dumps(warp))
    visit.page.set_input_files("#file", [PHOTOGRAPHS / "astronaut.png", path])
    visit.body(f"[data-handles='{len(warp['p'])}'][data-state=ready][data-source=png]")
    visit.ready()
    return visit


def chosen(visit):
    visit.page.click("#fit")
    visit.page.locator("#residuals > g").first.wait_for(state="attached")
    visit.ready()


def test_choose_for_me_selects_the_best_method_and_marks_the_wrong_pin(visit, tmp_path):
    seen = opened_with(visit, tmp_path, pair())
    before = seen.warp()
    chosen(seen)
    seen.keep("arrows")
    best = json.loads(
        seen.server.ask(
            "POST", "/fit", {"p": before["p"], "q": before["q"], "extent": [512, 512]}
        ).body
    )["best"]
    after = seen.warp()
    told = {name: value for name, value in best.items() if value}
    assert {name: after[name] for name in told} == told
    assert seen.page.locator(f"#method-{best['method']}").is_checked()
    words = seen.text("fit-note")
    assert (
        "predicts left-out pins best" in words
        and "px on average (RMS); Rigid" in words
        and f"Check pins {WRONG + 1}" in words
    )
    assert seen.page.locator("#residuals > g").count() == len(LANDMARKS)
    assert seen.page.locator(f"#residuals .outlier[data-residual='{WRONG}']").count() == 1
    assert seen.page.locator(f"#handle-{WRONG}").get_attribute("data-fault") == "warning"
    assert "from its prediction, an outlier" in seen.page.locator(f"#handle-{WRONG}").get_attribute(
        "aria-label"
    )
    assert words == seen.text("says")
    seen.page.click("#fit-arrows")
    assert (
        seen.page.locator("#residuals > g").count() == 0
        and seen.page.locator("#fit-note").is_visible()
    )
    seen.page.click("#fit-arrows")
    # Another position of a handle: the arrows are about others.
    seen.page.locator("#handle-2").focus()
    seen.page.keyboard.press("Enter")
    seen.page.keyboard.press("ArrowRight")
    seen.ready()
    assert seen.page.locator("#residuals > g").count() == 0 and seen.text("fit-note") == ""
    for _ in range(2):
        seen.page.click("#undo")
    seen.ready()
    assert seen.warp() == before


def test_too_few_pins_and_lines_cannot_be_compared(visit, tmp_path):
    seen = opened_with(visit, tmp_path, {"p": LANDMARKS[:4], "q": LANDMARKS[:4]})
    button = seen.page.locator("#fit")
    assert button.is_enabled()
    seen.page.locator("#handle-0").focus()
    seen.page.keyboard.press("Enter")
    seen.page.keyboard.press("Delete")
    seen.ready()
    assert button.is_disabled() and "4 pins or more" in seen.text("fit-note")
    seen.page.click("#pin-border")
    seen.ready()
    assert button.is_disabled() and "not with lines" in seen.text("fit-note")
