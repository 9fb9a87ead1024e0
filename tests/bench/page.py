#!/usr/bin/env python3
"""Compares two versions of the page: the work of the browser for a frame of a drag, block by block
in turns.

    tests/e2e/run -k nothing                     # creates the environment
    export MLSWARP_PROGRAM=target/debug/mlswarp
    tests/artefacts/e2e/venv/bin/python tests/bench/page.py OLD NEW [BLOCKS]

OLD and NEW are commits or directories with the files of `src/web`. One program answers both. A
frame is one movement of the mouse, and ends when the mesh of its pose is on the screen. Prints CPU
time per frame (it depends less on the load of the machine than elapsed time) of the page's main
thread, as the browser divides it, and of the whole browser, which includes drawing without a GPU;
then elapsed time from a movement of the pointer to its drawn mesh, the median of a block and its
slowest frame; and the median of the ratios new / old.
"""

import json
import math
import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
os.environ.setdefault("MLSWARP_PROGRAM", str(ROOT / "target" / "debug" / "mlswarp"))
os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"

from playwright.sync_api import sync_playwright

from support import CHROMIUM, FLAGS, KEPT, PHOTOGRAPHS, Server

FRAMES = 40
MEDIA = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
}
# `drawn` resolves when the next pose is on the screen, with the milliseconds since the pointer
# moved. It does not poll: frames requested while waiting would be part of the measurement.
WATCH = """() => void (window.drawn = new Promise((resolve) => {
  const { dataset } = document.body;
  const before = dataset.revision;
  let moved;
  addEventListener("pointermove", ({ timeStamp }) =>
    (moved = timeStamp), { once: true, capture: true });
  const watcher = new MutationObserver(() => {
    if (dataset.revision === before || dataset.shown !== dataset.revision) return;
    watcher.disconnect();
    requestAnimationFrame(() => resolve(performance.now() - moved));
  });
  watcher.observe(document.body, { attributeFilter: ["data-shown", "data-revision"] });
}))"""
# The server's PNG, which follows a pause of the pointer, is not part of a drag: it never comes.
WITHOUT_PNG = """() => {
  const plain = window.fetch;
  const never = (signal) =>
    new Promise((_, reject) =>
      signal?.addEventListener("abort", () => reject(new DOMException("", "AbortError"))));
  window.fetch = (path, options) =>
    (/\\/warp$/.test(path) ? never(options.signal) : plain(path, options));
}"""
MAIN_THREAD = {
    "script": ["ScriptDuration"],
    "style and layout": ["RecalcStyleDuration", "LayoutDuration"],
    "main thread": ["TaskDuration"],
}
# A page from the route below has no address, and a page of another site may not open sockets to
# this machine.
LOCAL = ["--disable-features=LocalNetworkAccessChecks,LocalNetworkAccessChecksWebSockets"]
TICKS = os.sysconf("SC_CLK_TCK")


def tree(name, folder):
    """The directory of a version."""
    if Path(name).is_dir():
        return Path(name)
    archive = subprocess.run(
        ["git", "archive", name, "src/web"], cwd=ROOT, check=True, stdout=subprocess.PIPE
    ).stdout
    folder.mkdir()
    subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    return folder / "src" / "web"


def warp_object(handles):
    """Points in a grid, some of them moved."""
    columns = math.ceil(math.sqrt(handles))
    p = [
        [30 + 450 * (n % columns) / columns, 30 + 450 * (n // columns) / columns]
        for n in range(handles)
    ]
    return {"p": p, "q": [[x + n % 5, y - n % 3] for n, (x, y) in enumerate(p)], "method": "rigid"}


class Version:
    """One version of the page with a picture and handles."""

    def __init__(self, browser, server, directory, handles, folder):
        self.context = browser.new_context(
            viewport={"width": 1280, "height": 800}, reduced_motion="reduce"
        )
        self.page = self.context.new_page()
        limits = re.search(r'content="(body=[^"]*)"', server.ask("GET", "/").body.decode())[1]
        self.context.route(
            f"{server.address}/", lambda route: self.serve(route, directory / "index.html", limits)
        )
        self.context.route(
            "**/page/*",
            lambda route: self.serve(route, directory / route.request.url.rsplit("/", 1)[1]),
        )
        self.page.goto(f"{server.address}/")
        self.page.set_input_files("#file", PHOTOGRAPHS / "astronaut.png")
        self.page.wait_for_selector("body[data-state=ready]")
        warp = folder / f"{handles}.json"
        warp.write_text(json.dumps(warp_object(handles)))
        self.page.set_input_files("#file", warp)
        self.page.wait_for_selector(
            f"body[data-state=ready][data-source=png][data-handles='{handles}']"
        )
        self.page.click("#zoom-full")
        self.page.evaluate(WITHOUT_PNG)
        self.session = self.context.new_cdp_session(self.page)
        self.session.send("Performance.enable", {"timeDomain": "threadTicks"})

    @staticmethod
    def serve(route, path, limits=""):
        body = (
            path.read_bytes().replace(b"{limits}", limits.encode(), 1)
            if limits
            else path.read_bytes()
        )
        route.fulfill(
            body=body, headers={"Content-Type": MEDIA[path.suffix], "Cache-Control": "no-cache"}
        )

    def times(self, pids):
        """CPU time so far in seconds, by name."""
        metrics = {
            metric["name"]: metric["value"]
            for metric in self.session.send("Performance.getMetrics")["metrics"]
        }
        times = {name: sum(metrics[part] for part in parts) for name, parts in MAIN_THREAD.items()}
        return times | {"whole browser": sum(map(cpu_time, pids()))}

    def drag(self, pids):
        """Drags the first handle; returns milliseconds per frame, by name: CPU time, and elapsed
        time from the pointer to the drawn mesh."""
        self.page.bring_to_front()
        box = self.page.locator("#handle-0").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.wait_for_selector("body[data-live=socket]")
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        before, waits = self.times(pids), []
        for frame in range(1, FRAMES + 1):
            turn = 2 * math.pi * frame / FRAMES
            self.page.evaluate(WATCH)
            self.page.mouse.move(x + 25 * math.sin(turn), y + 25 * (1 - math.cos(turn)))
            waits.append(self.page.evaluate("() => drawn"))
        after = self.times(pids)
        data = self.page.evaluate("({...document.body.dataset})")
        assert (data["moving"], data["source"], data["live"]) == ("true", "mesh", "socket"), data
        self.page.mouse.up()
        times = {name: 1e3 * (after[name] - before[name]) / FRAMES for name in after}
        return times | {"pointer to drawn": statistics.median(waits), "the slowest": max(waits)}


def cpu_time(pid):
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def descendants(pid):
    children = [
        int(child)
        for task in Path(f"/proc/{pid}/task").glob("*/children")
        for child in task.read_text().split()
    ]
    return [pid, *(one for child in children for one in descendants(child))]


def compare(playwright, server, directories, handles, blocks, folder):
    """Times of both versions in turns, each in a browser of its own."""
    versions, browsers = [], []
    for directory in directories:
        known = set(descendants(os.getpid()))
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS + LOCAL)
        main = next(pid for pid in descendants(os.getpid()) if pid not in known)
        browsers.append(browser)
        versions.append(
            (
                Version(browser, server, directory, handles, folder),
                lambda main=main: descendants(main),
            )
        )
    try:
        # The first block fills caches and compiles.
        times = [[version.drag(pids) for version, pids in versions] for _ in range(blocks + 1)][1:]
    finally:
        for browser in browsers:
            browser.close()
    for name in times[0][0]:
        old, new = ([block[n][name] for block in times] for n in (0, 1))
        ratios = sorted(b / a for a, b in zip(old, new))
        print(
            f"{handles:7}  {name:16}  {statistics.median(old):8.2f}  "
            f"{statistics.median(new):8.2f}  {statistics.median(ratios):6.2f}  {ratios[0]:.2f} to "
            f"{ratios[-1]:.2f}",
            flush=True,
        )


def main():
    old, new, *blocks = sys.argv[1:]
    blocks = int(blocks[0]) if blocks else 11
    KEPT.mkdir(parents=True, exist_ok=True)
    print(
        f"load {os.getloadavg()[0]:.1f}; CPU milliseconds per frame, medians of {blocks} blocks of "
        f"{FRAMES} frames"
    )
    print("handles  work                   old       new   ratio  of single pairs")
    server = Server("--log", "off")
    try:
        with sync_playwright() as playwright, tempfile.TemporaryDirectory() as scratch:
            scratch = Path(scratch)
            directories = [
                tree(name, scratch / which) for name, which in ((old, "old"), (new, "new"))
            ]
            for handles in (7, 300, 500):
                compare(playwright, server, directories, handles, blocks, scratch)
    finally:
        server.stop()


if __name__ == "__main__":
    main()
