"""Firefox and WebKitGTK (the engine of Safari) by Selenium, with Debian's browsers on a virtual
display, where both have WebGL."""

import io
import os
import select
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.webkitgtk.options import Options as WebKitOptions
from selenium.webdriver.webkitgtk.service import Service as WebKitService

import marionette
from support import DEADLINE, KEPT, Look

SIZE = (1280, 900)

# Records the errors of a page after it has loaded, and the sources of its pictures (`data-source`).
LISTEN = """
window.troubles = [];
window.sources = [];
new MutationObserver(() => sources.push(document.body.dataset.source))
  .observe(document.body, { attributeFilter: ["data-source"] });
addEventListener("error", (event) => troubles.push(`error: ${event.message}`));
addEventListener("unhandledrejection", (event) => troubles.push(`rejection: ${event.reason}`));
document.addEventListener("securitypolicyviolation", (event) =>
  troubles.push(`policy: ${event.blockedURI}`));
"""


@contextmanager
def display():
    """A virtual display; yields its name."""
    reader, writer = os.pipe()
    command = [
        program("Xvfb"),
        "-displayfd",
        str(writer),
        "-screen",
        "0",
        f"{SIZE[0]}x{SIZE[1]}x24",
        "-nolisten",
        "tcp",
        "-noreset",
    ]
    with open(KEPT / "xvfb.log", "wb") as log:
        server = subprocess.Popen(command, pass_fds=[writer], stdout=log, stderr=log)
    os.close(writer)
    try:
        ready, _, _ = select.select([reader], [], [], DEADLINE)
        number = os.read(reader, 16).strip() if ready else b""
        assert number, f"Xvfb does not start: {KEPT / 'xvfb.log'}"
        yield f":{number.decode()}"
    finally:
        os.close(reader)
        server.terminate()
        server.wait(DEADLINE)


def program(name):
    path = shutil.which(name)
    assert path, f"{name} is not in PATH: tests/run installs its Debian package"
    return path


def minibrowser():
    found = sorted(Path("/usr/lib").glob("*/webkit2gtk-4.*/MiniBrowser"))
    assert found, "there is no MiniBrowser: tests/run installs webkit2gtk-driver"
    return found[-1]


def environment(name, folder):
    """An environment in which the browser stores everything in the folder, and downloads too."""
    config = folder / "config"
    config.mkdir(parents=True)
    (folder / "downloads").mkdir()
    (config / "user-dirs.dirs").write_text(f'XDG_DOWNLOAD_DIR="{folder}/downloads"\n')
    homes = {
        "HOME": folder,
        "XDG_CONFIG_HOME": config,
        "XDG_CACHE_HOME": folder / "cache",
        "XDG_DATA_HOME": folder / "data",
    }
    return {**os.environ, **{key: str(value) for key, value in homes.items()}, "DISPLAY": name}


def firefox(name, folder):
    preferences = {
        "browser.download.folderList": 2,
        "browser.download.dir": str(folder / "downloads"),
        "browser.download.always_ask_before_handling_new_types": False,
    }
    return marionette.firefox(
        program("firefox-esr"),
        folder / "profile",
        preferences,
        KEPT / "firefox.log",
        environment(name, folder),
        DEADLINE,
    )


def webkit(name, folder):
    options = WebKitOptions()
    options.binary_location = str(minibrowser())
    options.add_argument("--automation")
    service = WebKitService(
        program("WebKitWebDriver"),
        log_output=str(KEPT / "webkit.log"),
        env=environment(name, folder),
    )
    return webdriver.WebKitGTK(options=options, service=service)


ENGINES = {"firefox": firefox, "webkit": webkit}


class Drive:
    """The page in one of the engines, with the vocabulary of `support.Visit`."""

    def __init__(self, driver, downloads):
        self.driver = driver
        self.downloads = downloads
        driver.set_window_size(*SIZE)

    def go(self, address):
        self.driver.get(address)
        self.until("the page has started", lambda data: data.get("webgl"))
        self.driver.execute_script(LISTEN)

    def begin(self, server):
        """Opens the page without a picture."""
        # The page of a picture would store it again when it is left.
        self.driver.get(f"{server.address}/problems/timeout")
        self.driver.execute_script("localStorage.clear(); sessionStorage.clear()")
        self.go(f"{server.address}/")
        data = self.data
        assert (data["state"], data["webgl"]) == ("empty", "webgl2"), data

    def recorded(self, what):
        """`troubles` or `sources` since the page has loaded."""
        return self.driver.execute_script(f"return window.{what}")

    @property
    def data(self):
        return self.driver.execute_script("return {...document.body.dataset}")

    def until(self, what, holds):
        """Waits for a state of the page; returns it."""
        give_up = time.monotonic() + DEADLINE
        while not holds(data := self.data):
            assert time.monotonic() < give_up, f"never came: {what}: {data}"
            time.sleep(0.05)
        return data

    def ready(self):
        """Waits for the server's PNG of the newest pose."""
        complete = {"state": "ready", "source": "png", "problem": ""}
        return self.until(
            "the server's picture",
            lambda data: complete.items() <= data.items() and data["shown"] == data["revision"],
        )

    def find(self, id):
        return self.driver.find_element(By.ID, id)

    def at(self, x, y):
        """Position of a picture position in the window, CSS px."""
        data = self.data
        left, top = self.driver.execute_script(
            "const { x, y } = document.getElementById('stage').getBoundingClientRect(); return [x, "
            "y]"
        )
        pan, zoom = [float(c) for c in data["pan"].split(",")], float(data["zoom"])
        return left + pan[0] + zoom * x, top + pan[1] + zoom * y

    def mouse(self, *steps):
        """Moves to picture positions; `down` and `up` press and release."""
        chain = ActionChains(self.driver, duration=30)
        for step in steps:
            if step == "down":
                chain.w3c_actions.pointer_action.pointer_down()
            elif step == "up":
                chain.w3c_actions.pointer_action.pointer_up()
            else:
                chain.w3c_actions.pointer_action.move_to_location(
                    *(round(c) for c in self.at(*step))
                )
        chain.perform()

    def look(self):
        """The picture on the stage."""
        png = self.driver.get_screenshot_as_png()
        shown = Image.open(io.BytesIO(png)).width / self.driver.execute_script("return innerWidth")
        assert shown == 1, f"the screenshot is scaled by {shown}"
        width, height = self.driver.execute_script(
            "const { naturalWidth: w, naturalHeight: h } = document.getElementById('original'); "
            "return [w, h]"
        )
        return Look(png, self.at(0, 0), self.at(width, height), float(self.data["zoom"]))

    def seen(self, what, holds):
        """Waits until the picture on the screen fits: a screenshot may be a frame older than the
        state of the page, and a frame may be one in which the picture is not drawn yet."""
        give_up = time.monotonic() + DEADLINE
        while True:
            try:
                if holds(look := self.look()):
                    return
                found = [look.centre(colour) for colour in ("red", "green", "blue")]
            except AssertionError as nothing:
                found = nothing
            assert time.monotonic() < give_up, f"never seen: {what}: {found}"

    def downloaded(self, button, name):
        """The bytes that a button of the page writes to the folder of downloads."""
        element = self.find(button)
        self.driver.execute_script(
            "window.clicks = 0; arguments[0].addEventListener('click', () => (clicks += 1), true)",
            element,
        )
        element.click()
        path = self.downloads / name
        began = time.monotonic()
        give_up, again = began + DEADLINE, began + DEADLINE / 6
        # Firefox writes to NAME.part beside it, WebKit to NAME.wkdownload; both rename at the end.
        while (
            not path.exists() or not path.stat().st_size or len(list(self.downloads.iterdir())) > 1
        ):
            clicks = self.driver.execute_script("return clicks")
            # On a busy machine a driver may click before the page listens, or beside the button:
            # only a click that the page has seen must have a file.
            if time.monotonic() > again and not clicks:
                element.click()
                again = give_up
            assert time.monotonic() < give_up, (
                f"{name} does not come after {clicks} clicks: {list(self.downloads.iterdir())}"
            )
            time.sleep(0.05)
        data = path.read_bytes()
        path.unlink()
        return data


@contextmanager
def started(engine, folder):
    with display() as name:
        driver = ENGINES[engine](name, folder)
        try:
            yield Drive(driver, folder / "downloads")
        finally:
            driver.quit()
