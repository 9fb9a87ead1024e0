"""Poses that the page computes by the server's coefficients, without requests."""

import json

import pytest

from links import distances
from support import BLUE, BROKEN, GREEN, RED, Server, discs, near


@pytest.fixture
def restartable():
    server = Server()
    yield server
    server.stop()


def pinned(visit, picture):
    visit.open(picture)
    for place in (RED, GREEN, BLUE):
        visit.click(*place)
    visit.body("[data-handles='3']").ready()
    visit.body("[data-plan]:not([data-plan=''])")
    return visit


def computed(visit, p, q):
    """The mesh of the page's own code for a session, as [grid, places]."""
    return visit.page.evaluate(
        """async ([id, p, q]) => {
          const { plan } = await import("./page/api.js");
          const { Plan } = await import("./page/plan.js");
          const mesh = new Plan(await plan(id, 41, 31)).pose(p, q);
          return [mesh.grid, [...mesh.places]];
        }""",
        [visit["session"], p, q],
    )


def test_a_drag_asks_the_server_for_nothing(visit, picture):
    sent, asked = [], []
    visit.page.on(
        "websocket", lambda socket: socket.on("framesent", lambda frame: sent.append(frame))
    )
    pinned(visit, picture)
    visit.page.on("request", lambda request: asked.append(request.url))
    # Poses are sent until the coefficients of new handles are here.
    sent.clear()
    with visit.without_pictures():
        visit.press(RED, (140, 130), steps=20)
        visit.body(f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}']")
        moving = visit.look()
        assert near(moving.centre("red"), (140, 130), 2.5)
        assert not [
            url for url in asked if not url.endswith(("/warp", visit["session"], "/mesh"))
        ], asked
        visit.page.mouse.up()
    visit.ready()
    assert not [message for message in sent if '"q"' in message], sent
    resting = visit.look()
    assert near(resting.centre("red"), (140, 130), 2.5)
    assert resting.differs(moving) < 0.02 * resting.image.width * resting.image.height
    assert visit.saved("download")[1] == visit.of_server().body


def test_the_page_shows_how_far_the_drawing_is_from_the_handles(visit, picture):
    pinned(visit, picture)
    # Not at a vertex of the lattice, unlike the others.
    visit.click(113, 153)
    visit.body("[data-handles='4']").ready()
    visit.body("[data-plan]:not([data-plan=''])")
    with visit.without_pictures():
        visit.press((113, 153), (150, 140))
        visit.body(f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}']")
        columns, rows = (int(c) for c in visit["plan"].split(","))
        shown = visit["residual"]
        assert 0 < float(shown) < 4 and visit.page.text_content("#timing-residual") == f"{shown} px"
        visit.page.mouse.up()
    visit.ready()
    assert visit["residual"] == f"{float(visit.of_server().getheader('Warp-Residual')):.2f}"
    # The same by the places of the handles alone.
    _, residual, at_handles = distances(visit, columns, rows, visit.warp()["q"])
    assert shown == f"{residual:.2f}" and abs(residual - at_handles) < 0.01


def test_what_is_drawn_is_the_mesh_of_the_server(visit, picture):
    """Points, a line, a twist, and each family."""
    pinned(visit, picture)
    visit.page.click("#tool-line")
    visit.click(60, 250)
    visit.click(340, 260)
    visit.page.click("#tool-point")
    visit.drag(RED, (130, 120))
    visit.drag((60, 250), (70, 235))
    for method in ("rigid", "similarity", "affine"):
        visit.page.click(f"#method-{method}")
        visit.ready()
        warp = visit.warp()
        grid, places = computed(visit, warp["p"], warp["q"])
        points = [[400 * i / 40, 300 * j / 30] for j in range(31) for i in range(41)]
        assert (grid["columns"], grid["rows"], grid["width"], grid["height"]) == (41, 31, 400, 300)
        answer = visit.server.ask(
            "POST", f"/sessions/{visit['session']}/points", {"q": warp["q"], "points": points}
        )
        exact = json.loads(answer.body)["points"]
        worst = max(
            abs(a - b)
            for k, point in enumerate(exact)
            for a, b in zip(point, places[2 * k : 2 * k + 2])
        )
        assert worst < 0.1, (method, worst)


@pytest.mark.parametrize("name", ["cat", "portrait", "rocket"])
def test_what_is_drawn_is_near_the_picture_of_the_server(visit, name):
    """Half a pixel at 95 of 100 places, 4 px at worst."""
    visit.sample(name)
    visit.body("[data-plan]:not([data-plan=''])")
    q = visit.warp()["q"]
    columns, rows = (int(c) for c in visit["plan"].split(","))
    # With 1,000 vertices, the worst place of two of these is 7 px off.
    for lattice in ((50, 50), (columns, rows)):
        found, residual, at_handles = distances(visit, *lattice, q)
        figures = found[len(found) // 2], found[len(found) * 95 // 100], found[-1], residual
        assert figures[1] <= 0.5 and figures[2] <= 4, (lattice, figures)
        # It is measured at the handles only, and along lines.
        assert at_handles - 0.01 <= residual <= figures[2] + 0.05, (lattice, figures, at_handles)


def test_new_handles_have_new_coefficients(visit, picture):
    """A file of other rest handles is never used."""
    pinned(visit, picture)
    held = []
    visit.page.route("**/plan?*", lambda route: held.append(route))
    visit.click(60, 250)
    visit.body("[data-handles='4']")
    visit.body("[data-plan='']")
    visit.press((60, 250), (80, 240))
    visit.body(
        f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}'][data-plan='']"
    )
    assert held
    for route in held:
        route.continue_()
    visit.page.unroute("**/plan?*")
    visit.body("[data-plan]:not([data-plan=''])")
    visit.page.mouse.move(*visit.at(90, 230), steps=4)
    visit.body(f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}']")
    visit.page.mouse.up()
    visit.ready()
    assert visit.saved("download")[1] == visit.of_server().body


@pytest.mark.parametrize("screen", [1, 1.25, 2])
def test_the_drawing_covers_the_picture_at_each_zoom(visits, tmp_path, screen):
    """Its canvas is the visible part of the picture: in the middle of the stage, beyond its edges,
    in pixels of the screen or of the picture."""
    visit = pinned(visits(device_scale_factor=screen), discs(tmp_path / "large.png", (1600, 1200)))
    visit.page.select_option("#canvas", "fit")
    # To and fro: without folds, which a coarser lattice shows elsewhere.
    for turn, times, way in ((600, 1, 1), (-600, 2, -1), (-600, 2, 1), (-600, 3, -1)):
        for _ in range(times):
            before = visit["zoom"]
            visit.page.mouse.move(*visit.at(*visit.posed(0)))
            visit.page.mouse.wheel(0, turn)
            visit.body(f":not([data-zoom='{before}'])").ready()
        x, y = visit.posed(0)
        still = visit.look()
        with visit.without_pictures():
            visit.press((x, y), (x + 30 * way, y + 20 * way))
            visit.body(f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}']")
            moving = visit.look()
            visit.page.mouse.up()
        visit.ready()
        resting = visit.look()
        assert resting.differs(moving) < 0.25 * resting.differs(still), (
            visit["zoom"],
            resting.differs(moving),
            resting.differs(still),
        )


def test_more_than_two_megabytes_of_coefficients_are_not_requested(visit, picture):
    """The socket sends meshes instead. Of a rigid point there are 15 kB."""
    asked = []
    visit.open(picture)
    visit.ready()
    visit.page.on("request", lambda request: asked.append(request.url))
    points = [RED, *([10 + 27 * (k % 14), 285 - 6 * (k // 14)] for k in range(139))]
    for count in (140, 130):
        handles = json.dumps({"p": points[:count], "q": points[:count]}).encode()
        visit.page.set_input_files(
            "#file", [{"name": "many.json", "mimeType": "application/json", "buffer": handles}]
        )
        visit.body(f"[data-handles='{count}']").ready()
        assert any("/plan?" in url for url in asked) == (count == 130), asked
        assert (visit["plan"] == "") == (count == 140)
        before = visit.look()
        with visit.without_pictures():
            visit.press(visit.posed(0), (140, 130))
            visit.body(f"[data-moving=true][data-source=mesh][data-shown='{visit['revision']}']")
            moving = visit.look()
            visit.page.mouse.up()
        visit.ready()
        resting = visit.look()
        assert resting.differs(moving) < 0.25 * resting.differs(before), (
            resting.differs(moving),
            resting.differs(before),
        )
        assert visit.saved("download")[1] == visit.of_server().body


def test_a_drag_continues_without_the_server_and_says_so(visits, picture, restartable):
    visit = pinned(visits(of=restartable), picture)
    visit.expects("404", *BROKEN)
    visit.press(RED, (120, 110))
    visit.body("[data-moving=true][data-source=mesh]")
    restartable.kill()
    visit.body("[data-behind=server]")
    assert visit.text("behind") == "Preview: the server does not respond"
    for x in (130, 140, 150):
        visit.page.mouse.move(*visit.at(x, 120), steps=3)
        visit.body(f"[data-moving=true][data-shown='{visit['revision']}']")
        assert near(visit.look().centre("red"), (x, 120), 2.5)
    visit.keep("without-a-server")
    visit.page.mouse.up()
    visit.body("[data-problem=network]")
    restartable.start()
    visit.ready()
    assert visit["behind"] == "" and visit.text("behind") == ""
    assert visit.saved("download")[1] == visit.of_server().body


def test_the_page_says_that_a_picture_is_late(visit, picture):
    pinned(visit, picture)
    with visit.without_pictures():
        visit.drag(RED, (130, 120))
        visit.body("[data-behind=picture]")
        assert "late" in visit.text("behind")
        visit.keep("late-picture")
    visit.ready()
    assert visit.text("behind") == ""
