"""A site of another origin: its server mints session tokens by the recipes of the guide, its pages
use them without the key, by requests, by the socket, and with the whole editor in a frame."""

import base64
import html
import json
import os
import re
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest

from support import DEADLINE, Server

KEY = "a-key-of-the-tests-0123456789"
ROOT = Path(__file__).resolve().parents[2]
RECIPES = dict(
    re.findall(
        r'<pre id="recipe-token-(\w+)"[^>]*>(.*?)</pre>',
        (ROOT / "src/web/docs/index.html").read_text(),
        re.S,
    )
)


class Site:
    """Pages of another origin, and what they were served as."""

    def __init__(self):
        self.pages = {}
        pages = self.pages

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                body = pages.get(self.path, "").encode()
                self.send_response(200)
                self.send_header("Content-Type", "text/html; charset=utf-8")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def stop(self):
        self.server.shutdown()


@pytest.fixture(scope="module")
def site():
    site = Site()
    yield site
    site.stop()


@pytest.fixture(scope="module")
def keyed(site):
    server = Server(
        *("--keys", f"ann {KEY}", "--frame-ancestors", site.address),
        *("--cors-origin", site.address),
    )
    yield server
    server.stop()
    assert KEY.encode() not in Path(server.log.name).read_bytes()


def recipe(name):
    return html.unescape(RECIPES[name]).strip()


def minted(server, language, folder):
    """What the recipe of a language prints."""
    file = folder / f"mint.{language}"
    file.write_text(recipe(language))
    command = {"sh": "bash", "py": sys.executable, "mjs": "node"}[language]
    done = subprocess.run(
        [command, file],
        env={**os.environ, "MLSWARP_SERVER": server.address, "MLSWARP_KEY": KEY},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def mint(server, session, **body):
    answer = httpx.post(
        f"{server.address}/sessions/{session}/tokens",
        headers={"Authorization": f"Bearer {KEY}"},
        json=body,
    )
    return answer.raise_for_status().json()["token"]


@pytest.mark.parametrize("language", ["sh", "py", "mjs"])
def test_a_site_mints_by_the_recipes_and_its_page_uploads_and_drags(
    keyed, site, browser, picture, language, tmp_path
):
    told = minted(keyed, language, tmp_path)
    assert set(told["ops"]) == {"read", "upload", "handles", "warp", "drag"}
    site.pages["/"] = f"<!doctype html><script>{recipe('browser')}</script>"
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{site.address}/")
    data = base64.b64encode(picture.read_bytes()).decode()
    size = page.evaluate(
        """async ([server, minted, data]) => {
          const image = await (await fetch(`data:image/png;base64,${data}`)).blob();
          const socket = await open(server, minted, image, [[60, 60], [180, 60]]);
          socket.binaryType = "arraybuffer";
          return new Promise((resolve, reject) => {
            socket.onerror = () => reject(new Error("the socket"));
            socket.onmessage = ({ data }) => {
              if (typeof data !== "string") return resolve(data.byteLength);
              socket.send(JSON.stringify({ seq: 1, q: [[90, 80], [180, 60]] }));
            };
          });
        }""",
        [keyed.address, told, data],
    )
    assert size > 1000
    # Nothing else of the key is open to it.
    other = page.evaluate(
        """([server, { token }]) => fetch(`${server}/points`, {
          method: "POST", headers: { Authorization: `Bearer ${token}` } }).then((r) => r.status)""",
        [keyed.address, told],
    )
    assert other == 403
    context.close()


FRAME = """<!doctype html>
<iframe style="width: 1200px; height: 780px; border: 0"></iframe>
<script>
RECIPE
const asked = [];
addEventListener("message", ({ data }) => asked.push(data.type));
embed(document.querySelector("iframe"), "SERVER", () => nextToken(), window.picture);
</script>"""


def test_the_editor_in_a_frame_works_by_tokens_of_the_site(keyed, site, browser, picture):
    session = "3e6cbb0e-5b4f-4f0c-9b7e-0a8f2c6a1d11"
    ops = ["read", "upload", "handles", "warp", "drag", "layers"]
    body = FRAME.replace("RECIPE", recipe("frame")).replace("SERVER", keyed.address)
    site.pages["/frame"] = body
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tokens = []

    def token():
        # The first one is short: it ends while the page is open.
        ttl = 8 if not tokens else 600
        tokens.append(mint(keyed, session, ops=ops, ttl=ttl, max_bytes=8 << 20))
        return tokens[-1]

    context.expose_function("nextToken", token)
    data = base64.b64encode(picture.read_bytes()).decode()
    context.add_init_script(
        f"""if (location.origin === "{site.address}") {{
          const bytes = Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0));
          window.picture = new File([bytes], "discs.png", {{ type: "image/png" }});
        }}"""
    )
    page = context.new_page()
    urls = []
    page.on("request", lambda request: urls.append(request.url))
    page.goto(f"{site.address}/frame")
    frame = page.frame_locator("iframe")
    ready = frame.locator('body[data-state="ready"]')
    ready.wait_for(timeout=DEADLINE * 1000)
    assert ready.get_attribute("data-session") == session
    assert len(tokens) == 1
    inner = next(one for one in page.frames if one.url.startswith(keyed.address))
    # The token is in memory alone.
    stored = inner.evaluate("() => JSON.stringify([{ ...sessionStorage }, { ...localStorage }])")
    assert tokens[0] not in stored and tokens[0].split(".")[2] not in stored
    stage = frame.locator("#stage").bounding_box()
    x, y = stage["x"] + stage["width"] / 2, stage["y"] + stage["height"] / 2

    def settled(handles):
        frame.locator(f'body[data-handles="{handles}"][data-problem=""]').wait_for()
        inner.wait_for_function(
            "() => document.body.dataset.shown === document.body.dataset.revision",
            timeout=DEADLINE * 1000,
        )

    page.mouse.click(x, y)
    settled(1)
    # A drag opens the socket, which closes when the token ends.
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y + 20, steps=5)
    frame.locator('body[data-live="socket"]').wait_for()
    page.mouse.up()
    settled(1)
    # The token ends; the page asks for another and goes on.
    page.wait_for_function("() => asked.includes('mlswarp-ready')")
    page.wait_for_function("() => asked.includes('mlswarp-token-expired')", timeout=DEADLINE * 1000)
    page.mouse.click(x + 60, y + 40)
    settled(2)
    assert len(tokens) >= 2
    assert not any(token in url for url in urls for token in tokens)
    context.close()


def test_a_frame_is_for_listed_sites_alone_and_so_is_a_token(keyed, site, browser):
    other = Site()
    body = FRAME.replace("RECIPE", recipe("frame")).replace("SERVER", keyed.address)
    other.pages["/frame"] = body.replace("nextToken()", "'a.e30.c'")
    context = browser.new_context()
    page = context.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(f"{other.address}/frame")
    page.wait_for_timeout(500)
    assert any("frame-ancestors" in text for text in said), said
    # A listed site frames a page that frames the editor: only its own parent is listened to.
    assert (
        httpx.get(f"{keyed.address}/")
        .headers["content-security-policy"]
        .endswith(f"frame-ancestors {site.address}")
    )
    context.close()
    other.stop()
