"""Live poses of the server during a drag: by socket or by requests, with and without WebGL.
`test_plan` has those without the server."""

import json

import pytest

from support import BLUE, CHROMIUM, FLAGS, GREEN, RED, near

WITHOUT_WEBGL = [flag for flag in FLAGS if "swiftshader" not in flag] + ["--disable-3d-apis"]


@pytest.fixture(scope="module")
def plain_browser(playwright):
    """One that has no WebGL at all."""
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=WITHOUT_WEBGL)
    yield browser
    browser.close()


def pin(visit):
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.body("[data-handles='3']").ready()
    return visit


def follows(visit, source):
    """A drag whose frames come from `source`, and then the server's picture."""
    still = visit.look()
    with visit.without_pictures():
        visit.press(RED, (140, 130))
        visit.body(f"[data-moving=true][data-source={source}][data-shown='{visit['revision']}']")
        moving = visit.look()
        assert moving.differs(still) > 500 and near(moving.centre("red"), (140, 130), 2.5)
        visit.page.mouse.up()
    visit.ready()
    assert near(visit.look().centre("red"), (140, 130), 2.5)
    assert visit.saved("download")[1] == visit.of_server().body
    return moving, visit.look()


def test_frames_come_by_the_socket_as_meshes(visits, picture):
    visit = visits(query="?plan=off")
    sockets, frames, sent = [], [], []

    def watch(socket):
        sockets.append(socket.url)
        socket.on("framereceived", lambda frame: frames.append(frame))
        socket.on("framesent", lambda frame: sent.append(frame))

    visit.page.on("websocket", watch)
    pin(visit.open(picture))
    assert (visit["live"], visit["webgl"]) == ("socket", "webgl2")
    moving, resting = follows(visit, "mesh")
    assert resting.differs(moving) < 0.02 * resting.image.width * resting.image.height
    assert all(
        f"/sessions/{visit['session']}/drag?" in url
        and "frames=mesh" in url
        and "mesh=compact" in url
        for url in sockets
    )
    grids = [
        grid
        for grid in (json.loads(frame) for frame in frames if isinstance(frame, str))
        if "columns" in grid
    ]
    binary = [frame for frame in frames if isinstance(frame, bytes)]
    assert binary and len(binary[-1]) == 12 + 4 * grids[-1]["columns"] * grids[-1]["rows"]
    assert grids[-1]["mesh"] == "compact" and grids[-1]["error"] <= grids[-1]["tolerance"] == 0.5
    reports = [
        report
        for report in (json.loads(frame) for frame in frames if isinstance(frame, str))
        if "error" in report and "seq" in report
    ]
    assert reports and all(report["error"] < 1 for report in reports)
    # Every frame is acknowledged, and the newest pose was sent.
    messages = [json.loads(message) for message in sent]
    acknowledged = [message["ack"] for message in messages if "ack" in message]
    assert (
        acknowledged == sorted(set(acknowledged))
        and int.from_bytes(binary[-1][:8], "little") in acknowledged
    )
    assert [m["q"] for m in messages if "q" in m][-1][0] == visit.warp()["q"][0]


def test_a_socket_that_nobody_answers_is_given_up(visits, picture):
    """A machine that is gone closes nothing: the pose takes another way."""
    visit = visits(query="?plan=off")
    pin(visit.open(picture))
    visit.page.route_web_socket("**/drag?*", lambda socket: None)
    visit.page.reload()
    pin(visit.open(picture))
    assert visit["live"] == "socket"
    with visit.without_pictures():
        visit.press(RED, (140, 130))
        visit.body("[data-moving=true][data-live=http]")
        visit.page.mouse.up()
    visit.ready()
    assert visit.saved("download")[1] == visit.of_server().body


def test_a_page_without_the_socket_asks_for_meshes(visits, picture):
    visit = visits(query="?socket=off&plan=off")
    pin(visit.open(picture))
    assert visit["live"] == "http"
    asked = []
    visit.page.on("request", lambda request: asked.append(request.url))
    visit.press(RED, (140, 130))
    # The pointer is still: on a slow server the full picture may arrive before a mesh.
    visit.body(f"[data-moving=true][data-shown='{visit['revision']}']")
    assert near(visit.look().centre("red"), (140, 130), 2.5)
    visit.page.mouse.up()
    visit.ready()
    assert [url for url in asked if url.endswith("/mesh")]
    assert visit.saved("download")[1] == visit.of_server().body


def test_a_browser_without_webgl_draws_the_servers_frames(visits, plain_browser, picture):
    visit = visits(browser=plain_browser)
    pin(visit.open(picture))
    assert (visit["webgl"], visit["live"]) == ("none", "socket")
    moving, resting = follows(visit, "frame")
    assert resting.differs(moving) < 0.05 * resting.image.width * resting.image.height
    # A handle on a bent picture is found through the inverse all the same.
    bent = visit.warp()
    visit.click(230, 160)
    visit.body("[data-handles='4']").ready()
    answer = visit.server.ask(
        "POST", "/points", {**bent, "extent": [400, 300], "points": [visit.warp()["p"][3]]}
    )
    assert near(json.loads(answer.body)["points"][0], (230, 160), 0.5)
    visit.page.click("#mesh")
    visit.keep("without-webgl")


def test_a_browser_with_neither_bends_as_well(visits, plain_browser, picture):
    visit = visits(browser=plain_browser, query="?socket=off")
    pin(visit.open(picture))
    assert (visit["webgl"], visit["live"]) == ("none", "http")
    visit.press(RED, (140, 130))
    visit.body(f"[data-moving=true][data-shown='{visit['revision']}']")
    assert near(visit.look().centre("red"), (140, 130), 2.5)
    visit.page.mouse.up()
    visit.ready()
    assert visit.saved("download")[1] == visit.of_server().body


def test_webgl_can_be_left_out_by_the_address(visits, picture):
    visit = visits(query="?webgl=off")
    pin(visit.open(picture))
    assert visit["webgl"] == "none"
    follows(visit, "frame")
