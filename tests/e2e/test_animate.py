"""Playing between rest and pose, in the browser alone, and the export as an animation."""

import io
import re
import zipfile

from PIL import Image, ImageSequence

from support import BLUE, GREEN, RED, Fingers, near
from test_output import run

MOVING = {"reduced_motion": "no-preference"}
GOAL = (140, 130)
# Records what is shown while it plays, and what is sent meanwhile.
WATCH = """() => {
  const { dataset } = document.body;
  Object.assign(window, { seen: [], asked: [] });
  new MutationObserver(() => {
    if (dataset.playing === "true") seen.push(Number(dataset.strength));
    else if (dataset.playing === "false" && seen.length) dataset.played = "";
  }).observe(document.body, { attributeFilter: ["data-strength", "data-playing"] });
  const watched = (on, name) => {
    const real = on[name];
    on[name] = function (...said) {
      if (dataset.playing === "true") asked.push(name);
      return real.apply(this, said);
    };
  };
  watched(window, "fetch");
  watched(XMLHttpRequest.prototype, "send");
  watched(WebSocket.prototype, "send");
}"""
# Holds the animation when this strength is shown (empty: any but the pose), until `goOn()`.
HOLD = """(wanted) => {
  const next = window.requestAnimationFrame;
  const held = [];
  const { dataset } = document.body;
  window.goOn = () => {};
  new MutationObserver((_, watch) => {
    if (dataset.playing !== "true" ||
      (wanted ? dataset.strength !== wanted : dataset.strength === "1")) return;
    watch.disconnect();
    next(() => {
      window.requestAnimationFrame = (step) => held.push(step);
      window.goOn = () => {
        window.requestAnimationFrame = next;
        held.forEach((step) => next(step));
      };
      dataset.held = "";
    });
  }).observe(document.body, { attributes: true });
}"""


def held(visit, wanted=""):
    """Plays until a strength is shown, and stays there."""
    visit.page.evaluate(HOLD, wanted)
    visit.page.click("#play")
    visit.body("[data-held]")


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
    visit.page.locator("#play").scroll_into_view_if_needed()
    box = visit.page.locator("#play").bounding_box()
    Fingers(visit).tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def test_it_plays_there_and_back_and_ends_at_the_pose(visits, picture):
    visit = bend(visits(has_touch=True, **MOVING), picture)
    before, warp, look = visit.data, visit.warp(), visit.look()
    for starts in (by_keyboard, by_space, by_touch):
        starts(visit)
        visit.body("[data-playing=true]")
        visit.keys("Escape")
        visit.body("[data-playing=false]")
    visit.page.evaluate(WATCH)
    by_mouse(visit)
    visit.body("[data-played]")
    seen = visit.page.evaluate("seen")
    # From the pose to rest and back, through what lies between.
    lowest = seen.index(min(seen))
    assert seen[0] > 0.9 and seen[lowest] < 0.1 and seen[-1] > 0.9
    assert (
        seen[:lowest] == sorted(seen[:lowest], reverse=True)
        and seen[lowest:] == sorted(seen[lowest:])
        and len(set(seen)) > 5
    )
    assert visit.page.evaluate("asked") == []
    after = visit.data
    assert (
        after == {**before, "played": ""}
        and visit.warp() == warp
        and visit.look().differs(look) == 0
    )


def test_what_plays_is_what_the_strength_shows(visits, picture):
    """Fewer, still frames with reduced motion: one of them is the pose at a strength that the
    slider can have."""
    visit = bend(visits(), picture)
    visit.page.uncheck("#play-back")
    visit.page.select_option("#play-easing", "linear")
    visit.page.evaluate(WATCH)
    held(visit, "0.5")
    half = visit.look()
    assert not visit.page.locator("#handle-0").is_visible()
    visit.page.evaluate("goOn()")
    visit.body("[data-played]")
    assert sorted(set(visit.page.evaluate("seen"))) == [0, 0.25, 0.5, 0.75, 1]
    visit.page.locator("#strength").fill("0.5")
    visit.ready()
    assert near(half.centre("red"), visit.look().centre("red"), 0.6)
    assert half.differs(visit.look()) < 0.02 * half.image.width * half.image.height
    # The settings stay; the way ends at the strength that is shown.
    visit.page.reload()
    visit.ready()
    assert (
        not visit.page.locator("#play-back").is_checked()
        and visit.page.input_value("#play-easing") == "linear"
    )
    visit.page.evaluate(WATCH)
    visit.page.click("#play")
    visit.body("[data-played]")
    assert max(visit.page.evaluate("seen")) == 0.5 and visit["strength"] == "0.5"


def stops_by_escape(visit):
    visit.keys("Escape")


def stops_by_button(visit):
    visit.page.click("#play:has-text('Stop')")


def stops_by_press(visit):
    visit.click(*BLUE)


def test_it_stops(visits, picture):
    visit = bend(visits(**MOVING), picture)
    visit.click(*GREEN)
    before = visit.data
    for stops in (stops_by_escape, stops_by_button, stops_by_press):
        held(visit)
        stops(visit)
        visit.body("[data-playing=false]")
        visit.page.evaluate("goOn()")
        assert visit.data == {**before, "held": ""}, f"{stops}: nothing is selected, added or moved"
        visit.page.evaluate("delete document.body.dataset.held")


def test_an_edit_ends_it(visits, picture):
    visit = bend(visits(**MOVING), picture)
    held(visit)
    visit.keys("Control+z")
    visit.body("[data-playing=false]")
    visit.page.evaluate("goOn()")
    visit.ready()
    assert near(visit.posed(0), RED, 0.6)


def test_a_session_that_has_ended_is_opened_again(visits, picture):
    visit = bend(visits(**MOVING), picture)
    visit.expects("404", "410")
    assert visit.server.ask("DELETE", f"/sessions/{visit['session']}").status == 204
    visit.page.evaluate(WATCH)
    visit.page.click("#play")
    visit.body("[data-played]")
    assert visit.ready()["handles"] == "3"


def test_without_webgl_it_says_why_not(visits, picture):
    visit = visits(query="?webgl=off")
    visit.open(picture)
    visit.click(*RED)
    visit.ready()
    assert visit.page.locator("#play").is_disabled() and "WebGL" in visit.text("play-note")


# Export


def choose(visit, **settings):
    """Opens the dialog and chooses an animation."""
    visit.page.click("#export-open")
    visit.page.click("label:has(#export-animation)")
    for name, value in settings.items():
        if name == "frames":
            visit.page.fill("#export-frames", str(value))
        elif name == "back":
            visit.page.locator("#export-back").set_checked(value)
        else:
            visit.page.select_option(f"#export-{name}", value)


def pixels(png):
    return Image.open(io.BytesIO(png)).convert("RGBA").tobytes()


def at_strength(visit, t):
    q = visit.warp()["q"]
    answer = visit.server.ask("POST", f"/sessions/{visit['session']}/warp", {"q": q, "strength": t})
    assert answer.status == 200, answer.body
    return pixels(answer.body)


def test_the_export_has_every_frame(visits, picture, tmp_path):
    visit = bend(visits(), picture)
    there, between = [0, 7 / 27, 20 / 27, 1], [20 / 27, 7 / 27]
    shown = {t: at_strength(visit, t) for t in there}
    # The first frame is the picture, one is the pose, and the others lie between them.
    assert shown[0] == Image.open(picture).convert("RGBA").tobytes() and shown[1] == pixels(
        visit.saved("download")[1]
    )
    for file, back in (
        ("apng", False),
        ("zip", True),
        ("apng", True),
        ("gif", True),
        ("zip", False),
    ):
        shares = there + between if back else there
        choose(visit, file=file, frames=4, easing="ease-in-out", back=back)
        assert visit.text("export-result").startswith(f"{len(shares)} frames, 400 × 300 px")
        name, exported = visit.saved("export-save")
        assert not visit.page.locator("#export").is_visible()
        if file == "apng":
            assert name == "discs-warped.apng"
            animation = Image.open(io.BytesIO(exported))
            assert animation.n_frames == len(shares)
            frames = [
                frame.convert("RGBA").tobytes() for frame in ImageSequence.Iterator(animation)
            ]
        elif file == "gif":
            assert name == "discs-warped.gif"
            animation = Image.open(io.BytesIO(exported))
            assert animation.n_frames == len(shares)
            # At most 256 colours: each frame is nearest to its own pose.
            drawn = [frame.convert("RGBA").tobytes() for frame in ImageSequence.Iterator(animation)]
            off = lambda a, b: sum(abs(m - n) for m, n in zip(a, b)) / len(a)
            frames = [min(shown.values(), key=lambda pose: off(frame, pose)) for frame in drawn]
        else:
            assert name == "discs-frames.zip"
            archive = zipfile.ZipFile(io.BytesIO(exported))
            frames = [
                pixels(archive.read(entry))
                for entry in sorted(archive.namelist())
                if entry.endswith(".png")
            ]
        assert frames == [shown[t] for t in shares], (file, back)
        # The command gives the same bytes; the choices are remembered.
        visit.page.click("#export-open")
        assert visit.text("export-result").startswith(f"{len(shares)} frames, 400 × 300 px")
        visit.page.click("#export-curl")
        visit.page.wait_for_selector("#export-said:text-matches('after the last request')")
        run(visit.page.evaluate("navigator.clipboard.readText()"), tmp_path)
        assert (tmp_path / name).read_bytes() == exported
        visit.keys("Escape")


def test_the_size_is_estimated_before_the_export(visits, picture):
    visit = bend(visits(), picture)
    for file in ("apng", "gif", "zip"):
        choose(visit, file=file, frames=10, back=True)
        visit.page.wait_for_selector(
            "#export-result:text-matches('18 frames, 400 × 300 px, about .*B$')"
        )
        number, unit = visit.text("export-result").rsplit("about ", 1)[1].split()
        told = float(number) * {"MiB": 1 << 20, "KiB": 1 << 10, "bytes": 1}[unit]
        assert 0.6 < told / len(visit.saved("export-save")[1]) < 1.7, file


def test_a_command_is_not_longer_than_a_shell_takes(visits, picture, tmp_path):
    """Linux limits an argument to 128 KiB."""
    visit = bend(visits(), picture)
    visit.page.click("#pin-border")
    visit.page.fill("#twist-2", "90")
    visit.page.keyboard.press("Enter")
    visit.ready()
    choose(visit, file="zip", frames=1400, back=False)
    visit.page.fill("#export-width", "1")
    visit.page.click("#export-curl")
    visit.page.wait_for_selector("#export-said:text-matches('after the last request')")
    line = visit.page.evaluate("navigator.clipboard.readText()")
    assert len(line) > 128 << 10
    run(line, tmp_path)
    assert len(zipfile.ZipFile(tmp_path / "discs-frames.zip").namelist()) == 1401
    # A failure says what to do: nothing is repeated by itself.
    visit.expects("ERR_FAILED")
    visit.page.route("**/batch", lambda route: route.abort())
    visit.page.click("#export-save")
    visit.page.wait_for_selector("#export-problem:text('The server does not respond. Try again.')")


def test_twists_turn_in_the_frames(visits, picture):
    """A twisted pin turns by a share of its angle, as the strength does it."""
    visit = bend(visits(), picture)
    visit.page.fill("#twist-2", "90")
    visit.page.keyboard.press("Enter")
    visit.ready()
    choose(visit, file="apng", frames=3, easing="linear", back=False)
    frames = ImageSequence.all_frames(Image.open(io.BytesIO(visit.saved("export-save")[1])))
    visit.page.locator("#strength").fill("0.5")
    visit.ready()
    assert len(frames) == 3 and frames[1].convert("RGBA").tobytes() == pixels(
        visit.saved("download")[1]
    )


def slow(visit, frames=2000):
    """An animation that takes longer than the test."""
    choose(visit, file="apng", frames=frames, easing="linear", back=False)
    visit.page.click("#export-save")
    visit.page.wait_for_selector("#export-progress-text:text-matches('^([2-9]|[0-9]{2,}) of ')")
    assert visit.page.locator("#export-progress").get_attribute("max") == str(frames)
    assert re.fullmatch(
        rf"\d+ of {frames} frames, [\d.]+ [KM]iB", visit.text("export-progress-text")
    )


def made(visit):
    """The number of frames that the server has made."""
    return int(
        re.search(
            rb"^\w*batch_frames\w* (\d+)", visit.server.ask("GET", "/metrics").body, re.MULTILINE
        )[1]
    )


def cancels_by_button(visit):
    visit.page.click("#export-cancel")


def cancels_by_closing(visit):
    visit.keys("Escape")
    visit.page.click("#export-open")


def test_cancelling_stops_it(visits, picture):
    visit = bend(visits(), picture)
    saved = []
    visit.page.on("download", lambda download: saved.append(download))
    focused = "document.activeElement.id"
    for cancels in (cancels_by_closing, cancels_by_button):
        before = made(visit)
        slow(visit)
        assert visit.page.evaluate(focused) == "export-cancel"
        cancels(visit)
        visit.page.wait_for_selector("#export-progress-row", state="hidden")
        assert cancels is cancels_by_closing or visit.page.evaluate(focused) == "export-save"
        assert (
            not visit.page.locator("#export-save").is_disabled()
            and not visit.page.locator("#export-problem").is_visible()
        )
        # The server stops too.
        last = None
        while last != (last := made(visit)):
            visit.page.wait_for_timeout(200)
        assert 2 <= last - before < 2000, cancels
        visit.keys("Escape")
    visit.page.click("#export-open")
    choose_again(visit, 3)
    with visit.page.expect_download():
        visit.page.click("#export-save")
    assert len(saved) == 1


def choose_again(visit, frames):
    visit.page.fill("#export-frames", str(frames))
    assert visit.text("export-result").startswith(f"{frames} frames")


def test_a_number_of_frames_that_the_server_would_reject_is_not_sent(visits, picture):
    visit = bend(visits(), picture)
    asked = []
    choose(visit, back=False)
    visit.page.on("request", lambda request: asked.append(request.url))
    for number, most in (("1", 10000), ("", 10000), ("10001", 10000)):
        visit.page.fill("#export-frames", number)
        assert visit.text("export-problem") == f"Enter 2 to {most} frames."
        visit.page.click("#export-save")
    assert not asked and visit.page.locator("#export").is_visible()
