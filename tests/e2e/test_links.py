"""The page over distant and poor links, with the server's coefficients and with the drag socket.
Waiting times are asserted, frame rates are not."""

import json
import os

import pytest

from links import Link, recorded
from support import BLUE, BROKEN, GREEN, RED, Server, near

# By the coefficients, and by meshes of the socket.
WAYS = pytest.mark.parametrize("query", ["", "?plan=off"], ids=["plan", "socket"])
LONG = os.environ.get("MLSWARP_TESTS_FULL") == "1"


@pytest.fixture
def restartable(request, tmp_path):
    """A server whose sessions survive its end. Its parameter: further flags."""
    server = Server("--store", f"file:{tmp_path / 'store'}", *getattr(request, "param", ()))
    yield server
    server.stop()


@pytest.fixture
def link(restartable):
    link = Link(restartable)
    yield link
    link.close()


class Drag:
    """A drag of the red disc over a link, whose stops are known by their revisions."""

    def __init__(self, visits, link, picture, query):
        self.link = link
        self.visit = visit = recorded(visits(of=link, query=query))
        visit.open(picture)
        for place in (RED, GREEN, BLUE):
            visit.click(*place)
        visit.body("[data-handles='3']").ready()
        self.is_local = not query
        if self.is_local:
            visit.body("[data-plan]:not([data-plan=''])")
        self.poses_before = visit.page.evaluate("seen.poses")
        visit.press(RED, RED, steps=1)
        self.stops = {int(visit["revision"]): RED}
        self.x = RED[0]

    def move(self, steps=1):
        """A few pixels to the right at each step."""
        for _ in range(steps):
            self.x += 1
            place = (self.x, RED[1] + 20)
            self.visit.page.mouse.move(*self.visit.at(*place))
            self.stops[int(self.visit["revision"])] = place
        return self

    def follows(self):
        """Waits for the newest pose; it is what is drawn."""
        self.visit.body(f"[data-shown='{self.visit['revision']}']")
        return self.is_labelled()

    def is_labelled(self):
        """What is drawn is the pose whose revision the page names."""
        while True:
            named = self.visit["shown"]
            look = self.visit.look()
            if self.visit["shown"] == named:
                break
        assert near(look.centre("red"), self.stops[int(named)], 2.5), (
            named,
            self.visit["revision"],
            self.stops,
        )
        return self

    def end(self):
        """Releases; the last pose arrives, and nothing was wrong on the way."""
        last = list(self.stops.values())[-1]
        self.visit.page.mouse.up()
        data = self.visit.ready()
        assert data["behind"] == "" and self.visit.text("behind") == ""
        assert near(self.visit.look().centre("red"), last, 2.5)
        assert near(self.visit.warp()["q"][0], last, 1)
        assert self.visit.saved("download")[1] == self.visit.of_server().body
        seen = self.visit.page.evaluate("seen")
        assert not seen["wrong"], "\n".join(seen["wrong"][:10])
        assert seen["unacknowledged"] <= 8, seen["unacknowledged"]
        # Behind an unanswered pose, newer ones are sent for 300 ms at most; 100 for the clock of
        # the record.
        assert max(seen["waits"], default=0) <= 400, max(seen["waits"])
        if self.is_local:
            assert seen["poses"] == self.poses_before, (
                "a pose was sent in spite of the coefficients"
            )
        return seen


@WAYS
def test_a_second_of_loss(visits, picture, link, query):
    drag = Drag(visits, link, picture, query)
    drag.move(5).follows()
    link.pause(1)
    drag.move(10).is_labelled()
    drag.move(20).is_labelled()
    drag.follows().end()


@WAYS
def test_the_rate_halves(visits, picture, link, query):
    drag = Drag(visits, link, picture, query)
    drag.move(10)
    for rate in (2.5, 1.2, 0.6):
        link.rate(rate)
        drag.move(10).is_labelled()
    drag.follows().end()


@WAYS
def test_seconds_without_a_connection(visits, picture, link, query):
    """The page says that it is behind, and continues by itself. Ten seconds in the long form: the
    page gives the socket up after five."""
    drag = Drag(visits, link, picture, query)
    visit = drag.visit
    drag.move(5).follows()
    link.pause(10 if LONG else 6)
    if drag.is_local:
        # The drawing is that of the newest pose.
        drag.move(20).follows()
    else:
        drag.move(20)
        visit.body("[data-behind]:not([data-behind=''])")
        # Poses that would queue are counted in the record.
        drag.move(10).is_labelled()
        assert int(visit["shown"]) < int(visit["revision"])
    # The pointer rests: now the server's picture is missing as well.
    visit.body("[data-behind]:not([data-behind=''])")
    assert visit.text("behind").startswith("Preview: the server")
    visit.keep(f"no-connection-{'plan' if drag.is_local else 'socket'}")
    drag.move(10)
    visit.body("[data-behind='']")
    drag.follows().end()


@WAYS
def test_a_server_that_is_killed_and_starts_again(visits, picture, link, restartable, query):
    drag = Drag(visits, link, picture, query)
    visit = drag.visit
    session = visit["session"]
    visit.expects("404", *BROKEN)
    drag.move(10).follows()
    restartable.kill()
    visit.body("[data-behind=server]")
    assert visit.text("behind") == "Preview: the server does not respond"
    drag.move(10).is_labelled()
    if drag.is_local:
        drag.follows()
    visit.body("[data-behind=server]")
    restartable.start()
    # The page finds it without being asked for anything.
    visit.body("[data-live=socket]")
    visit.body("[data-behind='']")
    drag.move(5)
    drag.move(5).follows().end()
    assert visit["session"] == session
    assert json.loads(restartable.ask("GET", f"/sessions/{session}").body)["id"] == session


def test_a_response_from_before_the_server_stopped(visits, picture, link, restartable):
    """It arrives after the connections have closed, and is no sign that the server responds."""
    drag = Drag(visits, link, picture, "")
    visit = drag.visit
    visit.expects("404", *BROKEN)
    held = []
    stopped = []
    visit.page.route(
        "**/sessions/*/warp",
        lambda route: route.continue_() if stopped else held.append((route, route.fetch())),
    )
    drag.move(5).follows()
    # The newest response; requests before it were cancelled by further movement.
    visit.page.wait_for_timeout(2000)
    assert held, "the picture of the resting pointer was not requested"
    stopped.append(True)
    restartable.kill()
    visit.body("[data-behind=server]")
    route, response = held[-1]
    route.fulfill(response=response)
    visit.body("[data-source=png]")
    # An attempt to open the socket has failed since.
    visit.page.wait_for_timeout(1500)
    assert visit["behind"] == "server"
    restartable.start()
    visit.body("[data-live=socket]")
    visit.body("[data-behind='']")
    drag.move(5).follows().end()


def test_a_drag_that_ends_without_a_connection(visits, picture, link):
    """The pose that was released there is an old one on the screen, and the page says so until the
    new one arrives."""
    drag = Drag(visits, link, picture, "?plan=off")
    visit = drag.visit
    drag.move(5).follows()
    link.pause(6)
    drag.move(30)
    visit.body("[data-behind=picture]")
    visit.page.mouse.up()
    visit.body("[data-moving=false]")
    assert visit["behind"] or visit["state"] == "ready"
    drag.end()


# The server notices the end of a session at its next ping of a silent socket.
@pytest.mark.parametrize("restartable", [("--socket-idle", "2s")], indirect=True)
def test_the_socket_of_an_ended_session_stays_closed(visits, picture, link, restartable):
    drag = Drag(visits, link, picture, "?plan=off")
    visit = drag.visit
    drag.move(5).follows().end()
    sockets = []
    visit.page.on("websocket", lambda socket: sockets.append(socket.url))
    assert restartable.ask("DELETE", f"/sessions/{visit['session']}").status == 204
    visit.body("[data-live=http]")
    visit.page.wait_for_timeout(3000)
    assert not sockets and visit["behind"] == ""
