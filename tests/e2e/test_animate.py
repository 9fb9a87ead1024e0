"""Playing between rest and pose, in the browser alone, and the export as an animation."""

import pytest

from support import BLUE, GREEN, RED, Fingers, near

MOVING = {"reduced_motion": "no-preference"}
GOAL = (140, 130)
# Records what is shown in each frame of the browser.
WATCH = """() => {
  window.seen = [];
  const look = () => {
    const { playing, strength } = document.body.dataset;
    if (playing === "true") seen.push(Number(strength));
    requestAnimationFrame(look);
  };
  look();
}"""


def bend(visit, picture):
    visit.open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.drag(RED, GOAL)
    visit.ready()
    return visit


def by_mouse(visit):
    visit.page.click("#play")


def by_keyboard(visit):
    visit.page.focus("#stage")
    visit.keys("p")


def by_space(visit):
    visit.page.focus("#play")
    visit.keys("Space")


def by_touch(visit):
    box = visit.page.locator("#play").bounding_box()
    Fingers(visit).tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


@pytest.mark.parametrize("starts", [by_mouse, by_keyboard, by_space, by_touch])
def test_it_plays_there_and_back_and_ends_at_the_pose(visits, picture, starts):
    visit = bend(visits(has_touch=starts is by_touch, **MOVING), picture)
    before, warp, look = visit.data, visit.warp(), visit.look()
    visit.page.evaluate(WATCH)
    starts(visit)
    visit.body("[data-playing=true]")
    asked = []
    visit.page.on("request", lambda request: asked.append(request.url))
    visit.body("[data-playing=false]")
    seen = visit.page.evaluate("seen")
    # From the pose to rest and back, through what lies between.
    lowest = seen.index(min(seen))
    assert seen[0] == 1 and seen[lowest] < 0.1 and seen[-1] > 0.9
    assert seen[:lowest] == sorted(seen[:lowest], reverse=True) and seen[lowest:] == sorted(seen[lowest:]) and len(set(seen)) > 8
    assert not asked
    after = visit.data
    assert {**after, "strength": "1"} == before and visit.warp() == warp and visit.look().differs(look) == 0


def test_what_plays_is_what_the_strength_shows(visits, picture):
    """Fewer, still frames with reduced motion: one of them is the pose at a strength that the slider can have."""
    visit = bend(visits(), picture)
    visit.page.uncheck("#play-back")
    visit.page.select_option("#play-easing", "linear")
    visit.page.evaluate(WATCH)
    visit.page.click("#play")
    visit.body("[data-playing=true][data-strength='0.5']")
    half = visit.look()
    assert not visit.page.locator("#handle-0").is_visible()
    visit.body("[data-playing=false]")
    assert sorted(set(visit.page.evaluate("seen"))) == [0, 0.25, 0.5, 0.75, 1]
    visit.page.locator("#strength").fill("0.5")
    visit.ready()
    assert near(half.centre("red"), visit.look().centre("red"), 0.6)
    assert half.differs(visit.look()) < 0.02 * half.image.width * half.image.height
    # The settings stay; the way ends at the strength that is shown.
    visit.page.reload()
    visit.ready()
    assert not visit.page.locator("#play-back").is_checked() and visit.page.input_value("#play-easing") == "linear"
    visit.page.evaluate(WATCH)
    visit.page.click("#play")
    visit.body("[data-playing=true][data-strength='0.25']")
    visit.body("[data-playing=false]")
    assert max(visit.page.evaluate("seen")) == 0.5 and visit["strength"] == "0.5"


def stops_by_escape(visit):
    visit.keys("Escape")


def stops_by_button(visit):
    visit.page.click("#play:has-text('Stop')")


def stops_by_press(visit):
    visit.click(*BLUE)


@pytest.mark.parametrize("stops", [stops_by_escape, stops_by_button, stops_by_press])
def test_it_stops(visits, picture, stops):
    visit = bend(visits(**MOVING), picture)
    visit.click(*GREEN)
    before = visit.data
    visit.page.click("#play")
    visit.body("[data-playing=true]")
    stops(visit)
    visit.body("[data-playing=false]")
    assert visit.data == before, "nothing is selected, added or moved"


def test_an_edit_ends_it(visits, picture):
    visit = bend(visits(**MOVING), picture)
    visit.page.click("#play")
    visit.body("[data-playing=true]")
    visit.keys("Control+z")
    visit.body("[data-playing=false]")
    visit.ready()
    assert near(visit.posed(0), RED, 0.6)


def test_a_session_that_has_ended_is_opened_again(visits, picture):
    visit = bend(visits(**MOVING), picture)
    visit.expects("404", "410")
    assert visit.server.ask("DELETE", f"/sessions/{visit['session']}").status == 204
    visit.page.click("#play")
    visit.body("[data-playing=true]").body("[data-playing=false]")
    assert visit.ready()["handles"] == "3"


def test_without_webgl_it_says_why_not(visits, picture):
    visit = visits(query="?webgl=off")
    visit.open(picture)
    visit.click(*RED)
    visit.ready()
    assert visit.page.locator("#play").is_disabled() and "WebGL" in visit.text("play-note")
