"""The page on a static host: the engine answers in place of a server, with the same bytes, under a
policy that allows nothing from elsewhere but WebAssembly."""

import base64
import hashlib
import io
import json
import struct
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from PIL import Image, ImageSequence

from support import DEADLINE, Visited
from test_access import faults
from test_outline import change, mean_change

ROOT = Path(__file__).resolve().parents[2]
CAT = ROOT / "src/web/cat.jpg"
HORSE = ROOT / "src/web/horse.webp"
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; worker-src 'self'"
)

# The head of a file, and no pixels.
BMP_OF_A_GIGAPIXEL = b"BM" + struct.pack(
    "<IIIIiiHHIIiiII", 54, 0, 54, 40, 32768, 32768, 1, 24, 0, 0, 0, 0, 0, 0
)

# Opens a session twice, replaces its handles twice at once, deletes it: the plans held each time.
PLANS_HELD = """async (image) => {
    const from = (path) => import(new URL(path, document.baseURI));
    const { answer } = await from("page/static/engine.js");
    const { prototype } = (await from("engine/worker-engine.js")).WorkerEngine;
    const [held, { plan: make }] = [new Set(), prototype];
    prototype.plan = async function (...given) {
        const plan = await make.apply(this, given);
        const free = plan.dispose;
        plan.dispose = () => held.delete(plan) && free.call(plan);
        held.add(plan);
        return plan;
    };
    const rest = { p: [[100, 100]], output: {} };
    const form = new FormData();
    form.set("image", await (await fetch(image)).blob());
    form.set("warp", new Blob([JSON.stringify(rest)]));
    const request = async (method, path, body) => {
        const { ok } = await answer(`/sessions/twice${path}`, { method, body });
        return ok ? held.size : method;
    };
    const replace = () => request("PUT", "/handles", JSON.stringify(rest));
    const counts = [await request("PUT", "", form), await request("PUT", "", form)];
    await Promise.all([replace(), replace()]);
    counts.push(held.size, await request("DELETE", ""));
    prototype.plan = make;
    return counts;
}"""


class Files(SimpleHTTPRequestHandler):
    """Files alone, and what was asked for."""

    def end_headers(self):
        self.send_header("Content-Security-Policy", POLICY)
        super().end_headers()

    def log_message(self, *_):
        self.server.asked.append((self.command, self.path))


class Host(Visited):
    def __init__(self, folder):
        self.http = ThreadingHTTPServer(("127.0.0.1", 0), partial(Files, directory=folder))
        self.http.asked = []
        # In a folder of the host, as sites of projects are.
        self.address = f"http://127.0.0.1:{self.http.server_port}/below"
        threading.Thread(target=self.http.serve_forever, daemon=True).start()

    def stop(self):
        self.leave()
        self.http.shutdown()


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    folder = tmp_path_factory.mktemp("host")
    subprocess.run([ROOT / "src/web/static/build", folder / "below"], check=True)
    host = Host(folder)
    yield host
    host.stop()


def by_server(server, saved, picture):
    """The file that the server makes of a picture and what the page has saved."""
    files = {"image": picture.read_bytes()}
    if "region" in saved:
        files["region"] = base64.b64decode(saved.pop("region"))
    files["warp"] = json.dumps(saved).encode()
    answer = httpx.post(f"{server.address}/warp", files=files, timeout=DEADLINE)
    assert answer.status_code == 200, answer.text
    return answer.content


def digest(file):
    return hashlib.sha256(file).hexdigest()


def downloaded(page):
    page.ready()
    return digest(page.saved("download")[1])


def animated(page, frames, kind="apng"):
    page.page.click("#export-open")
    page.page.click("label:has(#export-animation)")
    assert page.page.locator("#export-file option:disabled").count() == 1
    page.page.select_option("#export-file", kind)
    page.page.fill("#export-frames", str(frames))
    page.page.locator("#export-back").set_checked(True)
    return page.saved("export-save")[1]


def animation_by_server(server, saved, frames, picture=CAT, kind="apng"):
    q = saved.pop("q")
    files = {"image": picture.read_bytes(), "warp": json.dumps(saved).encode()}
    session = httpx.post(f"{server.address}/sessions", files=files, timeout=DEADLINE).json()
    batch = {"q": q, "steps": frames, "easing": "ease-in-out", "and_back": True}
    batch["delay"] = 1500 // (frames - 1)
    address = f"{server.address}/sessions/{session['id']}/batch"
    headers = {"Accept": f"image/{kind}"}
    return httpx.post(address, json=batch, headers=headers, timeout=DEADLINE).content


def frames_of(animation):
    """Size, alpha, and the pixels of each frame."""
    image = Image.open(io.BytesIO(animation))
    frames = [frame.tobytes() for frame in ImageSequence.Iterator(image)]
    return image.size, image.mode, image.n_frames, [digest(frame) for frame in frames]


def test_a_picture_is_opened_dragged_and_exported_as_by_the_server(visits, host, server):
    page = visits(of=host).body("[data-service=engine]")
    assert "works without a server" in page.text("drop")
    assert page.page.locator("#blend-open").is_disabled()
    assert faults(page) == []
    page.open(CAT)
    page.click(120, 100)
    page.click(300, 200)
    page.ready()

    # The grid follows the pointer, and the file comes when it rests.
    page.press((120, 100), (160, 130))
    page.body("[data-moving=true][data-source=mesh][data-residual]:not([data-residual=''])")
    page.page.mouse.up()
    png = downloaded(page)
    assert png == digest(by_server(server, page.warp(), CAT))
    posed = page.posed(0)
    assert posed != (120, 100) and float(page["residual"]) < 0.5
    page.keep("static")
    assert faults(page) == []

    # Strengths between rest and pose are drawn in turn.
    page.keys("p")
    page.body("[data-playing=true]")
    page.keys("Escape")

    # Settings and the mask of a region reach the engine.
    page.page.select_option("#canvas", "fit")
    page.page.select_option("#outside", "reflect")
    page.keys("4")
    page.drag((60, 40), (400, 40), (400, 280), (60, 280))
    page.body("[data-region='1']")
    assert downloaded(page) == digest(by_server(server, page.warp(), CAT)) != png
    page.keys("Control+z", "Control+z", "Control+z")
    assert downloaded(page) == png

    # An animation has the frames that the server draws, with alpha and on one canvas.
    page.page.select_option("#canvas", "fit")
    animation = animated(page, frames=3)
    assert frames_of(animation) == frames_of(animation_by_server(server, page.warp(), 3))
    page.keys("Control+z")

    # Folds are removed by the engine, too.
    corners = [[20, 20], [430, 20], [20, 280], [430, 280]]
    pulled = {"p": [*corners, [100, 150]], "q": [*corners, [330, 150]]}
    file = {"name": "pulled.json", "mimeType": "application/json"}
    page.page.set_input_files("#file", {**file, "buffer": json.dumps(pulled).encode()})
    page.body("[data-folds]:not([data-folds='0'])")
    page.page.check("#remove-folds")
    page.body("[data-folds='0']")
    assert downloaded(page) == digest(by_server(server, page.warp(), CAT))
    assert page.warp()["folds"] == "remove"
    page.keep("static-unfolded")
    page.keys("Control+z", "Control+z")
    assert downloaded(page) == png

    # Nothing but files was asked for.
    assert {method for method, _ in host.http.asked} == {"GET"}
    assert not [path for _, path in host.http.asked if "sessions" in path]

    # A reload opens the picture again, from this browser.
    page.page.reload()
    assert downloaded(page) == png and page.posed(0) == posed

    # A file that the engine refuses is told in its words, and nothing is lost.
    huge = {"name": "huge.bmp", "mimeType": "image/bmp", "buffer": BMP_OF_A_GIGAPIXEL}
    page.page.set_input_files("#file", huge)
    page.body("[data-problem=too_large]")
    assert "limit" in page.text("problem") and "operator" not in page.text("problem")
    assert page["state"] == "ready" and page.posed(0) == posed

    # Each plan that is replaced is freed.
    assert page.page.evaluate(PLANS_HELD, "page/cat.jpg") == [1, 1, 1, 0]


def test_a_leg_of_a_cut_out_bends_alone_without_a_server(visits, host, server):
    page = visits(of=host).body("[data-service=engine]")
    page.page.click("#sample-horse")
    page.ready()
    sample = page.saved("download")[1]
    assert page.page.is_checked("#metric-geodesic")
    assert digest(sample) == digest(by_server(server, page.warp(), HORSE))

    # One hind leg alone follows the pointer, in the preview too.
    page.keys("Escape")
    foot = tuple(page.warp()["q"][1])
    page.press(foot, (foot[0] + 20, foot[1] - 15), (foot[0] + 40, foot[1] - 30))
    page.body("[data-moving=true][data-source=mesh][data-residual]:not([data-residual=''])")
    page.keep("static-outline-preview")
    page.page.mouse.up()
    page.ready()
    page.keep("static-outline")
    bent = page.saved("download")[1]
    assert digest(bent) == digest(by_server(server, page.warp(), HORSE)) != digest(sample)
    before, after = (Image.open(io.BytesIO(file)).convert("RGBA") for file in (sample, bent))
    assert change(before, after, (160, 420, 260, 500)) > 50
    assert mean_change(before, after, (60, 420, 150, 500)) < 1

    # Puppet follows the outline too, and so does the threshold; undo leads back.
    page.page.locator("#threshold").fill("0.8")
    page.ready()
    page.page.click("label:has(#method-arap)")
    puppet = downloaded(page)
    assert page.warp()["mask"] == {"threshold": 0.8} and page.warp()["method"] == "arap"
    assert puppet == digest(by_server(server, page.warp(), HORSE)) != digest(bent)
    page.keep("static-puppet")
    page.keys("Control+z", "Control+z")
    assert downloaded(page) == digest(bent)

    # A pose that overtakes another one ends its picture.
    page.drag((foot[0] + 40, foot[1] - 30), foot)
    page.keys("Control+z")
    assert downloaded(page) == digest(bent)

    # On a canvas that shows all of it, a picture and an animation are those of the server.
    page.page.select_option("#canvas", "fit")
    page.ready()
    box = [float(edge) for edge in page["canvas"].split(",")]
    file = page.saved("download")[1]
    assert digest(file) == digest(by_server(server, page.warp(), HORSE))
    assert Image.open(io.BytesIO(file)).size == tuple(box[2:])
    animation = animated(page, frames=3)
    wanted = animation_by_server(server, page.warp(), 3, HORSE)
    assert frames_of(animation) == frames_of(wanted)
    wanted = animation_by_server(server, page.warp(), 3, HORSE, kind="gif")
    assert digest(animated(page, frames=3, kind="gif")) == digest(wanted)

    # A pin beside the outline is refused by the engine in the server's words.
    beside = {"p": [[5, 5]], "q": [[5, 5]], "metric": "geodesic"}
    file = {"name": "beside.json", "mimeType": "application/json"}
    page.page.set_input_files("#file", {**file, "buffer": json.dumps(beside).encode()})
    page.body("[data-problem=outside_mask]")


def test_an_outline_needs_no_transparency(visits, host, server):
    page = visits(of=host).body("[data-service=engine]")
    page.open(CAT)
    for place in ((120, 100), (300, 200), (60, 250), (400, 60)):
        page.click(*place)
    page.drag((120, 100), (150, 120))
    plain = downloaded(page)

    # Puppet follows the whole picture, where it is one.
    page.page.click("label:has(#method-arap)")
    whole = downloaded(page)
    assert whole == digest(by_server(server, page.warp(), CAT)) != plain

    # A region is an outline, and a new one is another.
    page.keys("Control+z", "4")
    page.drag((60, 20), (440, 20), (440, 290), (20, 290))
    page.page.click("label:has(#metric-geodesic)")
    page.keys("1")
    inside = downloaded(page)
    assert inside == digest(by_server(server, page.warp(), CAT))
    page.keys("4")
    page.page.click("label:has(#region-removes)")
    page.drag((200, 0), (220, 0), (220, 140), (200, 140))
    page.keys("1")
    cut = downloaded(page)
    assert cut == digest(by_server(server, page.warp(), CAT)) != inside
    page.keep("static-region-outline")
    page.keys("Control+z")
    assert downloaded(page) == inside
