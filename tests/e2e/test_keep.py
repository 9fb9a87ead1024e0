"""Persistence: over a reload, in a new tab, after the session has expired, after a restart of the
server."""

import pytest

from support import BLUE, BROKEN, GREEN, RED, SOCKET, Server, near


@pytest.fixture
def bent(opened):
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.drag(RED, (140, 130))
    opened.page.click("label:has(#method-similarity)")
    opened.ready()
    return opened.body("[data-kept=true]")


def whole(visit):
    """What must come back: the pose, the history, the picture."""
    visit.ready()
    return (
        visit.warp(),
        visit["undo"],
        visit["redo"],
        visit.page.title(),
        visit.saved("download")[1],
    )


def test_a_reload_loses_nothing(bent):
    bent.page.click("#undo")
    bent.ready()
    bent.body("[data-kept=true]")
    before, look = whole(bent), bent.look()
    bent.page.reload()
    assert whole(bent) == before
    assert bent.look().differs(look) == 0
    bent.page.click("#redo")
    bent.ready()
    assert bent.warp()["method"] == "similarity"


def test_a_reload_right_after_a_change_has_the_change(bent):
    bent.drag(BLUE, (220, 240))
    bent.page.reload()
    bent.ready()
    assert near(bent.posed(2), (220, 240), 0.6)


def test_a_reload_amid_a_drag_has_what_was_before_it(bent):
    bent.press(BLUE, (260, 260))
    bent.page.reload()
    bent.page.mouse.up()
    bent.ready()
    assert near(bent.posed(2), BLUE, 0.6) and near(bent.posed(0), (140, 130), 0.6)


def test_a_new_tab_goes_on_with_it(bent):
    before = whole(bent)
    tab = bent.context.new_page()
    bent.page.close()
    tab.goto(bent.address)
    bent.page = tab
    assert whole(bent) == before


def test_a_restarted_server_is_given_the_picture_again(visits, picture):
    server = Server()
    try:
        visit = visits(server).open(picture)
        for place in (RED, GREEN, BLUE):
            visit.click(*place)
        visit.drag(RED, (140, 130))
        visit.ready()
        visit.body("[data-kept=true]")
        before, session = whole(visit), visit["session"]
        visit.expects("404", *BROKEN)
        server.kill()
        server.start()
        # The browser has the file; no request is needed.
        visit.page.reload()
        assert whole(visit) == before
        assert visit["session"] != session
    finally:
        server.stop()


def test_a_session_that_has_ended_is_opened_again_while_one_works(bent):
    bent.expects("404", "410", SOCKET)
    first = bent["session"]
    assert bent.server.ask("DELETE", f"/sessions/{first}").status == 204
    bent.drag(BLUE, (220, 240))
    bent.ready()
    assert bent["session"] != first
    assert near(bent.look().centre("blue"), (220, 240), 3)
    assert bent.saved("download")[1] == bent.of_server().body


def test_two_tabs_at_one_session_both_get_their_pictures(bent):
    """Each tab numbers its requests; the superseded one sends its request again."""
    bent.expects("409")
    second = bent.context.new_page()
    second.goto(bent.address)
    second.wait_for_selector("body[data-state=ready]", state="attached")
    assert second.evaluate("document.body.dataset.session") == bent["session"]
    bent.drag((140, 130), (150, 150))
    bent.ready()
    second.click("#undo")
    second.wait_for_selector("body[data-state=ready]", state="attached")
    bent.drag((150, 150), (120, 120))
    bent.ready()
    assert bent.saved("download")[1] == bent.of_server().body


def test_a_tab_whose_session_got_other_handles_elsewhere_goes_on_with_its_own(bent):
    """The socket rejects a pose during a drag: the page recovers without user action."""
    bent.expects("422")
    second = bent.context.new_page()
    second.goto(bent.address)
    second.wait_for_selector("body[data-state=ready]", state="attached")
    session, handles = bent["session"], bent["handles"]
    second.click("#add")
    second.wait_for_selector(
        f"body[data-state=ready][data-handles='{int(handles) + 1}']", state="attached"
    )
    bent.page.bring_to_front()
    assert (bent["session"], bent["live"]) == (session, "socket")
    bent.drag((140, 130), (150, 150))
    bent.ready()
    assert bent["handles"] == handles and bent["session"] != session
    assert second.evaluate("document.body.dataset.session") == session
    assert bent.saved("download")[1] == bent.of_server().body


def test_the_theme_and_the_keys_are_remembered(visit):
    assert visit["theme"] == "auto"
    visit.page.click("#theme")
    visit.page.click("#theme")
    assert visit["theme"] == "dark"
    visit.page.click("#help-open")
    visit.page.uncheck("#keys")
    visit.page.reload()
    visit.body("[data-theme=dark]")
    assert visit.page.evaluate("getComputedStyle(document.body).colorScheme") == "dark"
    visit.page.click("#help-open")
    assert not visit.page.locator("#keys").is_checked()
