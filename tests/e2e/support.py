"""Shared parts of the browser tests: the program as a process, a visit of the page, and its
screenshots."""

import base64
import http.client
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import playwright.sync_api
from PIL import Image, ImageChops, ImageDraw

HERE = Path(__file__).resolve().parent
KEPT = HERE.parent / "artefacts" / "e2e"
PHOTOGRAPHS = HERE.parent / "images"
PROGRAM = os.environ["MLSWARP_PROGRAM"]

# No test asserts speed: this is the time after which something counts as hung.
DEADLINE = 60.0

# Debian's Chromium without a window and without background network requests. Without a GPU it
# composes the page on the CPU, and so does WebGL; with the window that nobody sees, that takes half
# as long again.
CHROMIUM = shutil.which("chromium-headless-shell")
FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
]


# The browser's message for a drag socket that does not open.
SOCKET = re.compile("WebSocket connection to .* failed")
# What the browser reports when connections break: to a server that was killed, at any moment of a
# response, or over a poor link.
BROKEN = (
    SOCKET,
    "ERR_CONNECTION_REFUSED",
    "ERR_CONNECTION_RESET",
    "ERR_CONNECTION_CLOSED",
    "ERR_EMPTY_RESPONSE",
    "ERR_INCOMPLETE_CHUNKED_ENCODING",
    "ERR_SOCKET_NOT_CONNECTED",
)


def crossed(these, those):
    """Pairs for a test: all of them in the long form, otherwise each of these with one of those in
    turn."""
    if os.environ.get("MLSWARP_TESTS_FULL") == "1":
        return [(this, that) for this in these for that in those]
    return [(this, those[k % len(those)]) for k, this in enumerate(these)]


class Visited:
    """A server that pages look at. They are closed before it ends: a request of theirs would find
    nobody, which is an error of the page."""

    visits = ()

    def leave(self):
        for visit in self.visits:
            visit.close()


class Server(Visited):
    """The program on a loopback port. After a restart it has the same port and an empty store."""

    def __init__(self, *flags):
        self.flags = flags
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            self.port = taken.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self):
        self.log = open(KEPT / f"server-{self.port}.log", "ab")
        self.process = subprocess.Popen(
            [
                PROGRAM,
                "serve",
                "--listen",
                f"127.0.0.1:{self.port}",
                "--drag-wait",
                "1m",
                *self.flags,
            ],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
        )
        give_up = time.monotonic() + DEADLINE
        while True:
            assert self.process.poll() is None, f"the program has ended: {self.log.name}"
            try:
                assert self.ask("GET", "/readyz").status == 200
                return
            except OSError:
                assert time.monotonic() < give_up, "the program does not listen"
                time.sleep(0.02)

    def kill(self):
        """Simulates a crash: connections break and sessions are lost."""
        self.process.kill()
        self.process.wait()
        self.log.close()

    def stop(self):
        """Stops the program, which must exit with 0 and without a panic."""
        self.leave()
        if self.log.closed:
            return
        self.process.send_signal(signal.SIGTERM)
        try:
            status = self.process.wait(DEADLINE)
        finally:
            self.kill()
        assert status == 0, f"the program ended with {status}: {self.log.name}"
        assert b"panicked" not in Path(self.log.name).read_bytes(), self.log.name

    def ask(self, method, path, value=None):
        """A request without the browser."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=DEADLINE)
        try:
            body = None if value is None else json.dumps(value)
            connection.request(
                method, path, body, {} if value is None else {"Content-Type": "application/json"}
            )
            response = connection.getresponse()
            response.body = response.read()
            return response
        finally:
            connection.close()


class Visit:
    """One user of the page: a separate browser context, and its errors."""

    def __init__(self, browser, server, *, query="", path="", expects=(), **options):
        self.server = server
        server.visits = (*server.visits, self)
        self.expected = set(expects)
        self.trouble = []
        options = {
            "viewport": {"width": 1280, "height": 800},
            "reduced_motion": "reduce",
            **options,
        }
        self.context = browser.new_context(
            permissions=["clipboard-read", "clipboard-write"], **options
        )
        self.context.set_default_timeout(1000 * DEADLINE)
        self.context.on("request", self._asked)
        self.page = self.context.new_page()
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.trouble.append(f"error in the page: {error}"))
        self.address = f"{server.address}/{query}{path}"
        self.answer = self.page.goto(self.address)
        self.body("[data-webgl]")

    def _asked(self, request):
        """Records requests to other hosts."""
        if not request.url.startswith((f"{self.server.address}/", "blob:", "data:")):
            self.trouble.append(f"asked for {request.url}")

    def _said(self, message):
        """Records errors. The browser reports every rejected request as an error; a test announces
        those that it causes with `expects`."""
        refused = re.search(
            r"Failed to load resource: (?:the server responded with a status of "
            r"(\d+)|net::(ERR_\w+))",
            message.text,
        )
        if refused and (refused[1] or refused[2]) in self.expected:
            return
        if any(isinstance(e, re.Pattern) and e.search(message.text) for e in self.expected):
            return
        if (
            message.type in ("error", "warning")
            and "GPU stall due to ReadPixels" not in message.text
        ):
            self.trouble.append(f"{message.type}: {message.text}")

    def expects(self, *refusals):
        """Expected statuses, network errors or patterns of messages."""
        self.expected.update(refusals)

    def close(self):
        self.context.close()

    # Observable state of the page

    def body(self, selector):
        """Waits until the attributes of the body match a CSS selector."""
        try:
            self.page.wait_for_selector(f"body{selector}", state="attached")
        except playwright.sync_api.TimeoutError as late:
            raise AssertionError(f"body{selector} never came: {self.data}") from late
        return self

    @property
    def data(self):
        return self.page.evaluate("({...document.body.dataset})")

    def __getitem__(self, name):
        return self.page.evaluate("(name) => document.body.dataset[name]", name)

    def ready(self):
        """Waits for the server's PNG of the newest pose; returns the state of the page."""
        while True:
            self.body("[data-state=ready][data-source=png]")
            data = self.data
            # Between the two looks, what was done before may have begun to change it.
            if data["state"] == "ready" and data["source"] == "png":
                break
        assert data["shown"] == data["revision"] and data["problem"] == "", data
        return data

    def text(self, id):
        return self.page.locator(f"#{id}").inner_text()

    # Opening

    def open(self, picture):
        """Opens a picture by the file chooser."""
        self.page.set_input_files("#file", picture)
        self.body("[data-state=ready]")
        return self

    def sample(self, name):
        self.page.click(f"#sample-{name}")
        self.ready()
        return self

    # Input

    def at(self, x, y):
        """Position of a picture position on the page, CSS px."""
        data, box = self.data, self.page.locator("#stage").bounding_box()
        pan = [float(c) for c in data["pan"].split(",")]
        zoom = float(data["zoom"])
        return box["x"] + pan[0] + zoom * x, box["y"] + pan[1] + zoom * y

    def click(self, x, y, **options):
        """Clicks at a picture position."""
        self.page.mouse.click(*self.at(x, y), **options)

    def drag(self, *places, steps=6):
        """Drags along picture positions and releases."""
        self.press(*places, steps=steps)
        self.page.mouse.up()

    def press(self, *places, steps=6):
        """The same without the release."""
        spots = [self.at(*place) for place in places]
        self.page.mouse.move(*spots[0])
        self.page.mouse.down()
        for spot in spots[1:]:
            self.page.mouse.move(*spot, steps=steps)

    @contextmanager
    def without_pictures(self):
        """Delays the server's pictures, so that the live preview is visible."""
        held = []
        self.page.route("**/sessions/*/warp", lambda route: held.append(route))
        yield
        for route in held:
            route.continue_()
        self.page.unroute("**/sessions/*/warp")

    def keys(self, *presses):
        for key in presses:
            self.page.keyboard.press(key)

    # Results

    def warp(self):
        """The handles as saved by the page."""
        return json.loads(self.saved("save-handles")[1])

    def posed(self, handle, vertex=None):
        """Position of a handle, picture px."""
        node = self.page.locator(f"#handle-{handle}" + ("" if vertex is None else f"-{vertex}"))
        return float(node.get_attribute("data-x")), float(node.get_attribute("data-y"))

    def saved(self, button):
        """Name and bytes of the download of a button."""
        with self.page.expect_download() as download:
            self.page.click(f"#{button}")
        return download.value.suggested_filename, Path(download.value.path()).read_bytes()

    def copied(self, button):
        """The text that a button copies."""
        self.page.click(f"#{button}")
        self.page.wait_for_selector("#toast.seen:text-matches('copied')")
        return self.page.evaluate("navigator.clipboard.readText()")

    def of_server(self, **output):
        """The response of the server to the current pose of the page."""
        warp = self.warp()
        body = {"q": warp["q"], **({"output": output} if output else {})}
        answer = self.server.ask("POST", f"/sessions/{self['session']}/warp", body)
        assert answer.status == 200, answer.body
        return answer

    # Screenshots

    def look(self):
        """The visible picture on the stage, without handles and bars."""
        over = "#handles, #marks, #moving, #loupe, #work > :not(#stage), main > :not(#work)"
        fade = (
            f"(opacity) => document.querySelectorAll('{over}').forEach((node) => "
            "(node.style.opacity = opacity))"
        )
        self.page.evaluate(fade, "0")
        shot = self.page.screenshot(scale="css")
        self.page.evaluate(fade, "")
        width, height = self.page.evaluate(
            "(({ naturalWidth: w, naturalHeight: h }) => [w, "
            "h])(document.querySelector('#original'))"
        )
        return Look(shot, self.at(0, 0), self.at(width, height), float(self["zoom"]))

    def keep(self, name):
        """Saves a screenshot of the page in the artefacts."""
        return self.page.screenshot(path=KEPT / f"{name}.png")


def tell(visit, kinds, *files):
    """Events by which a browser brings files (name, media type, bytes); tells whether the page took
    each of them for its own."""
    return visit.page.evaluate(
        """([kinds, files]) => {
          const carried = new DataTransfer();
          for (const [name, type, base64] of files) {
            const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
            carried.items.add(new File([bytes], name, { type }));
          }
          const wish = { bubbles: true, cancelable: true };
          return kinds.map((kind) => !document.body.dispatchEvent(kind === "paste"
            ? new ClipboardEvent(kind, { ...wish, clipboardData: carried })
            : new DragEvent(kind, { ...wish, dataTransfer: carried })));
        }""",
        [kinds, [(name, media, base64.b64encode(bytes).decode()) for name, media, bytes in files]],
    )


class Look:
    """A screenshot of the picture on the stage, read in pixels of the picture."""

    def __init__(self, png, first, last, zoom):
        whole = Image.open(io.BytesIO(png)).convert("RGB")
        corner = [max(0, round(c)) for c in first]
        self.image = whole.crop(
            (*corner, *(min(side, round(c)) for side, c in zip(whole.size, last)))
        )
        self.pan = [a - b for a, b in zip(first, corner)]
        self.zoom = zoom

    def colour(self, x, y):
        return self.image.getpixel(
            tuple(int(pan + self.zoom * c) for pan, c in zip(self.pan, (x, y)))
        )

    def mask(self, name):
        """255 where a colour of `discs` dominates."""
        bands = dict(zip(("red", "green", "blue"), self.image.split()))
        wanted = bands.pop(name)
        return ImageChops.subtract(wanted, ImageChops.lighter(*bands.values())).point(
            lambda more: 255 if more > 90 else 0
        )

    def centre(self, name):
        """The centroid of a colour, picture px."""
        mask = self.mask(name)
        box = mask.getbbox()
        assert box, f"nothing {name} is seen"
        left, top, right, _ = box
        wide = right - left
        spots = [k for k, seen in enumerate(mask.crop(box).tobytes()) if seen]
        x = left + 0.5 + sum(k % wide for k in spots) / len(spots)
        y = top + 0.5 + sum(k // wide for k in spots) / len(spots)
        return (x - self.pan[0]) / self.zoom, (y - self.pan[1]) / self.zoom

    def differs(self, other):
        """Number of pixels that differ visibly from another look."""
        red, green, blue = ImageChops.difference(self.image, other.image).split()
        return sum(ImageChops.lighter(ImageChops.lighter(red, green), blue).histogram()[13:])


# Positions of the discs in the picture of `discs`.
RED, GREEN, BLUE = (100, 100), (320, 90), (200, 220)


def discs(path, size=(400, 300)):
    """Three coloured discs on grey: the position of a disc shows the displacement."""
    image = Image.new("RGB", size, (200, 200, 200))
    draw = ImageDraw.Draw(image)
    for (x, y), colour in ((RED, (230, 20, 20)), (GREEN, (20, 170, 20)), (BLUE, (20, 40, 230))):
        draw.ellipse((x - 24, y - 24, x + 24, y + 24), fill=colour)
    image.save(path)
    return path


def near(a, b, within):
    """Whether the distance of two positions is below a limit, px."""
    return max(abs(m - n) for m, n in zip(a, b, strict=True)) <= within


class Fingers:
    """Touch input, which the browser converts to pointer events."""

    def __init__(self, visit):
        self.visit = visit
        self.session = visit.context.new_cdp_session(visit.page)
        self.down = {}

    def _send(self, kind):
        points = [{"id": id, "x": x, "y": y} for id, (x, y) in self.down.items()]
        self.session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def put(self, **spots):
        """Touches down, by name, in sequence."""
        for name, spot in spots.items():
            self.down[ord(name[0])] = spot
            self._send("touchStart")

    def move(self, steps=6, **spots):
        """Moves touches simultaneously."""
        begun = {name: self.down[ord(name[0])] for name in spots}
        for step in range(1, steps + 1):
            for name, spot in spots.items():
                a = begun[name]
                self.down[ord(name[0])] = tuple(p + (q - p) * step / steps for p, q in zip(a, spot))
            self._send("touchMove")
        # The browser delivers move events once per frame.
        self.visit.page.evaluate(
            "new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))"
        )

    def lift(self, *names):
        for name in names or [chr(id) for id in list(self.down)]:
            del self.down[ord(name[0])]
            self._send("touchEnd")

    def take_away(self):
        """A touch cancelled by the system."""
        self.down = {}
        self._send("touchCancel")

    def tap(self, x, y):
        self.put(a=(x, y))
        self.lift()
