"""A server that wants a key: the page asks for it, keeps it in this browser, and never gives it
away."""

import base64
import os
import subprocess
import time

import pytest

from support import BLUE, DEADLINE, RED, SOCKET, Server, discs, near

KEY = "a-key-of-the-tests-0123456789"
OTHER = "another-key-of-the-tests-98765"


@pytest.fixture(scope="module")
def locked():
    server = Server("--keys", f"ann {KEY},bob {OTHER}")
    yield server
    server.stop()
    log = open(server.log.name, "rb").read()
    assert KEY.encode() not in log


def give(visit, key, remember=False):
    visit.page.fill("#key-field", key)
    visit.page.set_checked("#key-remember", remember)
    visit.page.click("#key-use")


def test_what_was_refused_is_done_once_the_key_is_there(visits, locked, picture, tmp_path):
    visit = visits(locked)
    visit.expects("401", "403")
    sockets = []
    visit.page.on("websocket", lambda socket: sockets.append(socket))
    asked = []
    visit.page.on("request", lambda request: asked.append(request.url))
    visit.page.set_input_files("#file", picture)
    visit.body("[data-problem=unauthorized]")
    assert visit.text("problem-title") == "API key required" and visit.text("problem-detail") == ""
    visit.page.click("#problem-action")
    # By its label, with the keyboard. The page rejects an invalid key, the server a wrong one.
    field = visit.page.get_by_label("Key", exact=True)
    assert field.get_attribute("type") == "password"
    field.fill("short")
    field.press("Enter")
    assert visit.page.locator("#key-wrong").is_visible()
    visit.keep("key")
    field.fill("a-wrong-key-0123456789")
    field.press("Enter")
    visit.body("[data-problem=forbidden]")
    # The page does not claim that a rejected key is of use.
    assert visit.text("toast") == ""
    visit.page.click("#problem-action")
    give(visit, KEY)
    visit.body("[data-state=ready]")
    visit.page.wait_for_selector("#toast.seen")
    assert visit.text("toast") == "The server accepts the key"
    visit.click(*RED)
    visit.click(*BLUE)
    visit.ready()
    visit.drag(RED, (120, 120))
    visit.ready()
    assert near(visit.look().centre("red"), (120, 120), 1.5)
    assert visit["live"] == "socket" and sockets
    # Never in an address.
    secret = base64.urlsafe_b64encode(KEY.encode()).decode().rstrip("=")
    for url in asked + [socket.url for socket in sockets] + [visit.page.url]:
        assert KEY not in url and secret not in url
    # Exported commands contain a variable instead of the key.
    png = visit.saved("download")[1]
    line = visit.copied("copy-curl")
    assert '-H "Authorization: Bearer $MLSWARP_KEY"' in line and KEY not in line
    assert KEY not in visit.copied("copy-link")
    (tmp_path / picture.name).write_bytes(picture.read_bytes())
    subprocess.run(
        ["sh", "-c", line], cwd=tmp_path, env={**os.environ, "MLSWARP_KEY": KEY}, check=True
    )
    assert (tmp_path / f"{picture.stem}-warped.png").read_bytes() == png


MEDIA = """new Promise((then) => { indexedDB.open("mlswarp").onsuccess = ({ target }) =>
  (target.result.transaction("files").objectStore("files").getAll().onsuccess = ({ target }) =>
    then(target.result.map(({ type }) => type))); })"""


@pytest.mark.parametrize("way", ["changed", "removed"])
def test_annotations_do_not_follow_into_the_account_of_another_key(
    visits, locked, picture, tmp_path, way
):
    visit = visits(locked)
    visit.expects("401", "404", SOCKET)
    asked = []
    visit.page.on("request", lambda request: asked.append((request.url, request.headers)))
    visit.page.click("#help-open")
    visit.page.click("#key-open")
    give(visit, KEY)
    # Those of the picture that is open, and of one that undo brings back.
    cells = tmp_path / "cells.geojson"
    cells.write_text('{"type": "Point", "coordinates": [50, 60]}')
    for size in ((400, 300), (330, 260)):
        visit.open(discs(tmp_path / f"{size[0]}.png", size))
        visit.page.set_input_files("#file", cells)
        visit.body("[data-annotations=exact][data-kept=true]")
    assert visit.page.evaluate(MEDIA).count("application/geo+json") == 2
    # The same key once more is no other one.
    for key in (KEY, OTHER):
        visit.page.click("#help-open")
        visit.page.click("#key-open")
        if key == OTHER and way == "removed":
            visit.page.click("#key-forget")
        else:
            give(visit, key)
        if key == KEY:
            assert visit["annotations"] == "exact"
    visit.page.wait_for_selector("#toast.seen:text-matches('Annotations are closed')")
    assert visit["annotations"] == ""
    assert "application/geo+json" not in visit.page.evaluate(MEDIA)
    if way == "removed":
        visit.page.click("#help-open")
        visit.page.click("#key-open")
        give(visit, OTHER)
    asked.clear()
    visit.click(50, 60)
    visit.ready()
    visit.keys("Control+z", "Control+z")
    visit.body("[data-redo='2']").ready()
    assert visit["annotations"] == "" and visit.page.title().startswith("400.png")
    visit.page.reload()
    visit.ready()
    assert visit["annotations"] == ""
    assert not [url for url, _ in asked if url.endswith("/points")]


@pytest.mark.parametrize("way", ["changed", "reloaded", "stepped"])
def test_nor_out_of_the_account_of_a_key_that_was_removed(visits, picture, tmp_path, way):
    """The old key is refused by then, as one is that never had an account."""
    keys = tmp_path / "keys"
    keys.write_text(f"ann {KEY}\nbob {OTHER}\n")
    server = Server("--keys-file", str(keys))
    visit = visits(server)
    visit.expects("401", "403", "404", SOCKET)
    asked = []
    visit.page.on("request", lambda request: asked.append(request.url))
    visit.page.click("#help-open")
    visit.page.click("#key-open")
    give(visit, KEY)
    cells = tmp_path / "cells.geojson"
    cells.write_text('{"type": "Point", "coordinates": [50, 60]}')
    visit.open(picture)
    visit.page.set_input_files("#file", cells)
    visit.body("[data-annotations=exact][data-kept=true]")
    if way == "stepped":
        visit.page.click("h1 a")
        visit.body("[data-annotations='']")
    new = tmp_path / "new"
    new.write_text(f"bob {OTHER}\n")
    new.rename(keys)
    opened = visit.page.evaluate("() => JSON.parse(sessionStorage.mlswarp)")
    session = opened.get("session") or opened["earlier"][0]["session"]
    status = f"""fetch("sessions/{session}", {{ headers: {{ Authorization: "Bearer {KEY}" }} }})
      .then((response) => response.status)"""
    give_up = time.monotonic() + DEADLINE
    while visit.page.evaluate(status) == 200:
        assert time.monotonic() < give_up, "the file of keys is not read again"
        time.sleep(0.1)
    asked.clear()
    if way == "reloaded":
        visit.page.reload()
    elif way == "stepped":
        visit.page.click("#undo")
    else:
        visit.click(*RED)
    visit.body(":is([data-problem=unauthorized], [data-problem=forbidden])")
    visit.page.click("#problem-action")
    give(visit, OTHER)
    visit.page.wait_for_selector("#toast.seen:text-matches('Annotations are closed')")
    visit.ready()
    assert visit["annotations"] == "" and visit["problem"] == ""
    assert "application/geo+json" not in visit.page.evaluate(MEDIA)
    visit.click(*BLUE)
    visit.ready()
    assert not [url for url in asked if url.endswith("/points")]
    server.stop()


def test_annotations_wait_while_keys_are_refused(visits, locked, picture, tmp_path):
    """A key that was never accepted had no account that they could be of."""
    visit = visits(locked)
    visit.expects("401", "403")
    cells = tmp_path / "cells.geojson"
    cells.write_text('{"type": "Point", "coordinates": [50, 60]}')
    visit.page.set_input_files("#file", [cells, picture])
    visit.body("[data-problem=unauthorized]")
    for key in ("a-wrong-key-0123456789", OTHER):
        visit.page.click("#problem-action")
        give(visit, key)
        visit.body("[data-problem=forbidden]" if key != OTHER else "[data-annotations=exact]")


def test_the_key_lives_as_long_as_is_wished(visits, locked, picture):
    visit = visits(locked)
    visit.expects("401", SOCKET)
    visit.page.click("#help-open")
    visit.page.click("#key-open")
    assert not visit.page.locator("#key-forget").is_visible()
    give(visit, OTHER)
    visit.open(picture)
    visit.page.reload()
    visit.body("[data-state=ready]")
    # A tab of its own has none.
    stored = "() => [sessionStorage, localStorage].map((storage) => storage.getItem('mlswarp.key'))"
    assert visit.page.evaluate(stored) == [OTHER, None]
    visit.page.click("#help-open")
    visit.page.click("#key-open")
    give(visit, OTHER, remember=True)
    assert visit.page.evaluate(stored) == [None, OTHER]
    visit.page.click("#help-open")
    visit.page.click("#key-open")
    assert (
        visit.page.locator("#key-field").input_value() == ""
        and visit.page.locator("#key-remember").is_checked()
    )
    visit.page.click("#key-forget")
    assert visit.page.evaluate(stored) == [None, None]
    visit.click(*RED)
    visit.body("[data-problem=unauthorized]")
    visit.page.click("#problem-action")
    give(visit, OTHER)
    visit.ready()
    assert visit["problem"] == ""
