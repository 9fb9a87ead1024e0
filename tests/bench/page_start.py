#!/usr/bin/env python3
"""Starts the page in a new browser profile, from a static host and from the program in turns.

    tests/e2e/run -k nothing                     # creates the environment
    export MLSWARP_PROGRAM=target/release/mlswarp
    tests/artefacts/e2e/venv/bin/python tests/bench/page_start.py [PICTURE] [RUNS]

Prints medians, and the least and the greatest, of elapsed milliseconds: from the request for the
page until it takes a picture; from the choice of a picture until the exact file is on the screen,
which waits for the engine where there is no server; and from the first movement of a pin until its
mesh is on the screen. Then what the browser fetches until the picture is there, each file with
gzip, as hosts send them. All of it on this machine, without a network.
"""

import gzip
import os
import statistics
import subprocess
import sys
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
os.environ.setdefault("MLSWARP_PROGRAM", str(ROOT / "target" / "release" / "mlswarp"))
os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"

from playwright.sync_api import sync_playwright

from support import CHROMIUM, FLAGS, KEPT, PHOTOGRAPHS, Server

# When the body first was in each state, and the event before it.
WATCH = """() => {
  const seen = (window.seen = {});
  const note = (name) => requestAnimationFrame(() => (seen[name] ??= performance.now()));
  addEventListener("change", () => (seen.chosen ??= performance.now()), { capture: true });
  addEventListener("pointermove", ({ buttons, timeStamp }) =>
    buttons && (seen.moved ??= timeStamp), { capture: true });
  const look = () => {
    const { webgl, state, source, moving, shown, revision } = document.body.dataset;
    if (webgl) note("started");
    if (state === "ready" && source === "png") note("opened");
    if (moving === "true" && source === "mesh" && shown === revision && seen.moved) note("drawn");
  };
  addEventListener("DOMContentLoaded", () =>
    new MutationObserver(look).observe(document.body, { attributes: true }));
}"""
STEPS = {
    "the page takes a picture": (None, "started"),
    "the picture is open": ("chosen", "opened"),
    "the first frame is drawn": ("moved", "drawn"),
}


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


class Host:
    """The files of `src/web/static/build`."""

    def __init__(self, folder):
        subprocess.run([ROOT / "src/web/static/build", folder], check=True)
        self.http = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
        self.address = f"http://127.0.0.1:{self.http.server_port}"
        threading.Thread(target=self.http.serve_forever, daemon=True).start()

    def stop(self):
        self.http.shutdown()


def start(playwright, server, picture):
    """Milliseconds of each step, and the bytes that were fetched until the picture was there."""
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    try:
        page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        page.add_init_script(f"({WATCH})()")
        files = []
        page.context.on("response", lambda response: files.append(response))
        page.goto(f"{server.address}/")
        page.wait_for_selector("body[data-webgl]")
        page.set_input_files("#file", picture)
        page.wait_for_selector("body[data-state=ready][data-source=png]")
        fetched = [file for file in files if file.request.method == "GET" and file.ok]
        names = {file.url for file in fetched if "/sessions/" not in file.url}
        names = {name for name in names if name.startswith(server.address)}
        sizes = [len(gzip.compress(page.request.get(name).body(), 9)) for name in names]
        box = page.locator("#stage").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.click(x - 60, y)
        page.mouse.click(x + 60, y)
        page.wait_for_selector("body[data-state=ready][data-source=png][data-handles='2']")
        page.mouse.move(x - 60, y)
        page.mouse.down()
        page.mouse.move(x - 30, y + 20, steps=3)
        page.wait_for_function("seen.drawn")
        seen = page.evaluate("seen")
        times = {name: seen[to] - seen.get(since, 0) for name, (since, to) in STEPS.items()}
        return times, len(sizes), sum(sizes)
    finally:
        browser.close()


def main():
    picture = Path(sys.argv[1]) if len(sys.argv) > 1 else PHOTOGRAPHS / "astronaut.png"
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else 9
    KEPT.mkdir(parents=True, exist_ok=True)
    print(f"load {os.getloadavg()[0]:.1f}; {picture.name}; {runs} runs of each in turns")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as scratch:
        hosts = {"static host": Host(Path(scratch) / "page"), "program": Server("--log", "off")}
        try:
            results = {name: [] for name in hosts}
            for _ in range(runs):
                for name, host in hosts.items():
                    results[name].append(start(playwright, host, picture))
        finally:
            for host in hosts.values():
                host.stop()
    for name, result in results.items():
        for step in STEPS:
            times = sorted(times[step] for times, *_ in result)
            middle = statistics.median(times)
            print(f"{name:12} {step:26} {middle:7.0f} ms ({times[0]:.0f} to {times[-1]:.0f})")
        _, files, size = result[-1]
        print(f"{name:12} {files} files, {size / 1000:.0f} kB with gzip")


if __name__ == "__main__":
    main()
