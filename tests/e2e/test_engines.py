"""The page in Firefox and in WebKitGTK: opened, bent, saved and reloaded."""

import io
import json

import pytest
from PIL import Image

from engines import ENGINES, started
from support import BLUE, GREEN, KEPT, RED, near


@pytest.fixture(scope="module", params=ENGINES)
def drive(request, tmp_path_factory):
    with started(request.param, tmp_path_factory.mktemp(request.param)) as drive:
        drive.engine = request.param
        yield drive


def test_a_picture_is_opened_bent_saved_and_restored(drive, server, picture):
    drive.begin(server)
    drive.find("file").send_keys(str(picture))
    drive.until("the picture", lambda data: data["state"] == "ready")
    for n, place in enumerate((RED, GREEN, BLUE), 1):
        drive.mouse(place, "down", "up")
        drive.until("a pin", lambda data: data["handles"] == str(n))
    drive.ready()
    drive.until("the socket", lambda data: data["live"] == "socket")

    # During a drag the browser draws the mesh that the socket sends.
    drive.driver.execute_script("sources.length = 0")
    moved = (RED[0] + 40, RED[1] + 20)
    drive.mouse(RED, "down", (RED[0] + 10, RED[1] + 5), moved)
    dragged = drive.until(
        "a dragged pose",
        lambda data: data["moving"] == "true" and data["shown"] == data["revision"],
    )
    assert dragged["live"] == "socket" and "mesh" in drive.recorded("sources"), dragged
    drive.mouse("up")
    state = drive.ready()
    # The pin covers the middle of its disc.
    drive.seen(
        "the bent picture",
        lambda look: near(look.centre("red"), moved, 4) and near(look.centre("green"), GREEN, 4),
    )
    drive.driver.save_screenshot(str(KEPT / f"{drive.engine}.png"))

    warp = json.loads(drive.downloaded("save-handles", "discs-handles.json"))
    assert near(warp["p"][0], RED, 1.5) and near(warp["q"][0], moved, 3), warp
    png = drive.downloaded("download", "discs-warped.png")
    assert Image.open(io.BytesIO(png)).size == (400, 300)
    answer = server.ask("POST", f"/sessions/{state['session']}/warp", {"q": warp["q"]})
    assert (answer.status, answer.body == png) == (200, True), "the saved file is the server's"

    drive.until("stored in the browser", lambda data: data["kept"] == "true")
    assert drive.recorded("troubles") == []
    server.ask("DELETE", f"/sessions/{state['session']}")
    drive.go(f"{server.address}/")
    restored = drive.ready()
    assert restored["handles"] == "3" and restored["session"] != state["session"], restored
    drive.seen("the restored picture", lambda look: near(look.centre("red"), moved, 4))
    assert drive.recorded("troubles") == []


@pytest.mark.parametrize("sample", ["portrait", "cat", "horse", "rocket"])
def test_a_sample_is_opened(drive, server, sample):
    drive.begin(server)
    drive.find(f"sample-{sample}").click()
    state = drive.ready()
    assert int(state["handles"]) > 3
    assert drive.recorded("troubles") == []


def test_the_documentation_is_shown(drive, server):
    drive.driver.get(f"{server.address}/docs")
    drive.until(
        "the guide", lambda _: drive.driver.find_elements("css selector", "body[data-state=ready]")
    )
    drive.driver.find_element("css selector", "#warp .run").click()
    drive.until(
        "the warped picture",
        lambda _: drive.driver.find_elements("css selector", "#warp .results img"),
    )
    drive.driver.get(f"{server.address}/docs/reference")
    drive.until(
        "the operations",
        lambda _: (
            "Delete a session" in drive.driver.find_element("css selector", "#reference").text
        ),
    )
