#!/usr/bin/env python3
"""
The page behind a slow link, in Chromium: frames drawn during a drag, the reaction to its first
movement, the time until a new handle is posed without requests, the distance of the drawing from
the exact deformation, and a drag during which the server is killed and starts again.

    tests/e2e/run -k nothing                     # creates the environment
    cargo build --release --locked -p mlswarp-server --bin mlswarp --example link
    export MLSWARP_PROGRAM=target/release/mlswarp
    tests/artefacts/e2e/venv/bin/python tests/bench/page_link.py [MBIT MS [WIDTH HEIGHT]]

The link has MBIT Mbit/s (5) and MS ms each way (75); the window has WIDTH x HEIGHT CSS px (1280 x
800). A frame is a display frame in which another pose was drawn. The pointer moves once in each
display frame. Figures are printed with the
coefficients and with `?plan=off`, where meshes come by the socket. JavaScript: the median time to
pose and to draw.

Without a graphics card, the browser draws and composes with the CPU; the time of a frame depends on
the pixels of the canvas of the live preview.
Screenshots and pictures of the timelines are in tests/artefacts/e2e (page-link-*.png).
"""

import math
import os
import statistics
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
os.environ.setdefault("MLSWARP_PROGRAM", str(ROOT / "target" / "release" / "mlswarp"))
os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"

from PIL import Image, ImageDraw
from playwright.sync_api import sync_playwright

from links import Link, distances
from support import CHROMIUM, FLAGS, KEPT, SOCKET, Server, Visit

SECONDS = 3
ERRORS = (
    "CONNECTION_RESET",
    "CONNECTION_CLOSED",
    "EMPTY_RESPONSE",
    "CONNECTION_REFUSED",
    "SOCKET_NOT_CONNECTED",
)
BROKEN = ("404", *(f"ERR_{error}" for error in ERRORS))
# All times are those of the page, ms. `spans`: [begin, end, words]. `work`: how long posing and
# drawing take.
RECORD = """(() => {
  const now = () => performance.now();
  const seen = (window.seen =
    { pointer: [], ticks: [], drawn: [], sent: [], received: [], behind: [], plan: [] });
  seen.work = { pose: [], draw: [] };
  window.WebSocket = class extends WebSocket {
    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => typeof data !== "string" &&
        seen.received.push(now()));
    }
    send(text) {
      super.send(text);
      if (!text.includes('"ack"')) seen.sent.push(now());
    }
  };
  const point = ({ timeStamp, type }) => seen.pointer.push([timeStamp, type]);
  for (const type of ["pointermove", "pointerup"]) addEventListener(type, point, { capture: true });
  let last = {};
  const look = () => {
    const { shown, plan, behind, moving } = document.body.dataset;
    seen.ticks.push(now());
    if (shown !== last.shown && moving === "true") seen.drawn.push(now());
    if (plan !== last.plan) seen.plan.push([now(), plan]);
    const words = document.getElementById("behind").textContent;
    if (behind !== last.behind) seen.behind.push([now(), behind ? words : ""]);
    last = { shown, plan, behind };
    requestAnimationFrame(look);
  };
  addEventListener("DOMContentLoaded", async () => {
    requestAnimationFrame(look);
    const timed = (type, name, times) => {
      const plain = type.prototype[name];
      type.prototype[name] = function (...all) {
        const begun = now();
        const result = plain.apply(this, all);
        times.push([begun, now() - begun]);
        return result;
      };
    };
    timed((await import("./page/plan.js")).Plan, "pose", seen.work.pose);
    timed((await import("./page/paint.js")).Painter, "paint", seen.work.draw);
  });
})()"""


class Recording:
    """What the page has done since now."""

    def __init__(self, visit):
        self.visit = visit
        self.begun = visit.page.evaluate("performance.now()")

    def end(self):
        page, begun = self.visit.page, self.begun
        self.ended = page.evaluate("performance.now()")
        seen = page.evaluate("seen")
        later = lambda times: [t for t in times if t >= begun]
        self.moves = [t for t, kind in seen["pointer"] if kind == "pointermove" and t >= begun]
        self.releases = [t for t, kind in seen["pointer"] if kind == "pointerup" and t >= begun]
        self.ticks, self.drawn, self.sent, self.received = (
            later(seen[name]) for name in ("ticks", "drawn", "sent", "received")
        )
        self.work = {
            name: [took for t, took in times if t >= begun] for name, times in seen["work"].items()
        }
        self.behind, self.plan = (self.spans(seen[name]) for name in ("behind", "plan"))
        of_entry = "(e) => [e.startTime, e.responseEnd, e.name, e.encodedBodySize]"
        entries = page.evaluate(f"performance.getEntriesByType('resource').map({of_entry})")
        entries = [entry for entry in entries if entry[0] >= begun and "/sessions/" in entry[2]]
        self.requests = [
            (a, b or self.ended, name.split("?")[0].rsplit("/", 1)[-1][:8])
            for a, b, name, _ in entries
        ]
        self.table = next((size for *_, name, size in entries if "/plan?" in name), 0)
        return self

    def spans(self, changes):
        ends = [t for t, _ in changes[1:]] + [self.ended]
        return [
            (max(t, self.begun), end, words)
            for (t, words), end in zip(changes, ends)
            if end > self.begun and words
        ]

    def told(self, name, seconds=SECONDS):
        gaps = [b - a for a, b in zip(self.drawn, self.drawn[1:])]
        first = self.drawn[0] - self.moves[0] if self.drawn and self.moves else math.nan
        middle = {
            name: statistics.median(times) if times else math.nan
            for name, times in self.work.items()
        }
        print(
            f"  {name}: {len(self.drawn) / seconds:.0f} frames/s of "
            f"{len(self.ticks) / seconds:.0f} display frames/s, "
            f"first after {first:.0f} ms, longest gap {max(gaps, default=math.nan):.0f} ms; "
            f"JavaScript: pose {middle['pose']:.1f} ms, draw {middle['draw']:.1f} ms"
        )

    def picture(self, path, title):
        """The timeline: a row for each kind of event, a second is 320 px wide."""
        across = lambda t: 150 + 0.32 * (t - self.begun)
        # Requests that overlap are below each other.
        lanes = []
        for request in sorted(self.requests):
            lane = next((lane for lane in lanes if lane[-1][1] <= request[0]), None)
            lanes.append([request]) if lane is None else lane.append(request)
        rows = [("pointer", self.moves, "#888888"), ("frames drawn", self.drawn, "#1b7f3b")]
        rows += [
            ("poses sent", self.sent, "#7a4fbf"),
            ("meshes received", self.received, "#b3560f"),
        ]
        rows += [("requests" if k == 0 else "", lane, "#2b6cb0") for k, lane in enumerate(lanes)]
        rows += [("coefficients", self.plan, "#94c9a4"), ("the page says", self.behind, "#d9534f")]
        image = Image.new("RGB", (int(across(self.ended)) + 30, 60 + 28 * len(rows)), "white")
        draw = ImageDraw.Draw(image)
        draw.text((8, 6), title, fill="black")
        for second in range(int((self.ended - self.begun) // 500) + 1):
            x = across(self.begun + 500 * second)
            draw.line((x, 26, x, image.height - 6), fill="#dddddd")
            draw.text((x + 2, 24), f"{second / 2:g} s", fill="#666666")
        for k, (name, events, colour) in enumerate(rows):
            top = 44 + 28 * k
            draw.text((8, top + 4), name, fill="black")
            for event in events:
                if isinstance(event, tuple):
                    begin, end, words = event
                    draw.rectangle(
                        (across(begin), top, max(across(end), across(begin) + 1), top + 18),
                        fill=colour,
                        outline="white",
                    )
                    draw.text(
                        (across(begin) + 3, top + 4),
                        words,
                        fill="black" if colour == "#94c9a4" else "white",
                    )
                else:
                    draw.line((across(event), top, across(event), top + 18), fill=colour)
        image.save(path)


# One movement in each display frame, as a browser delivers them: a movement from outside takes a
# round trip of several frames.
CIRCLE = """([x, y, radius, seconds]) => {
  const begun = performance.now();
  let end;
  window.circled = new Promise((resolve) => (end = resolve));
  const move = () => {
    const share = (performance.now() - begun) / (1000 * seconds);
    if (share >= 1) return end();
    const angle = 4 * Math.PI * share;
    const at = { clientX: x + radius * Math.sin(angle),
      clientY: y + radius - radius * Math.cos(angle) };
    const pointer = { pointerId: 1, pointerType: "mouse", isPrimary: true, buttons: 1,
      bubbles: true, ...at };
    document.getElementById("stage").dispatchEvent(new PointerEvent("pointermove", pointer));
    requestAnimationFrame(move);
  };
  requestAnimationFrame(move);
  // Not the promise: the caller does not wait.
  return null;
}"""


def drag(visit, start, steps=(), seconds=SECONDS):
    """Moves a handle on a circle, without a release. `steps` are called one after the other, at
    equal times."""
    x, y = visit.at(*start)
    visit.page.mouse.move(x, y)
    visit.page.mouse.down()
    recording = Recording(visit)
    # The first movement is a real one.
    visit.page.mouse.move(x + 5, y)
    visit.page.evaluate(CIRCLE, [x, y, 25 * float(visit["zoom"]), seconds])
    for step in steps:
        visit.page.wait_for_timeout(1000 * seconds / (len(steps) + 1))
        step()
    visit.page.evaluate("circled")
    return recording.end()


def opened(browser, link, query, window):
    visit = Visit(browser, link, query=query, expects=(SOCKET, *BROKEN), viewport=window)
    visit.page.add_init_script(RECORD)
    visit.page.reload()
    visit.body("[data-webgl]")
    return visit.sample("cat")


def without_the_server(visit, server, name):
    """The server is killed after a third of a drag, and starts again after two thirds."""

    def start():
        visit.keep(f"page-link-{name}-killed")
        server.start()

    recording = drag(visit, visit.posed(0), [server.kill, start], 2 * SECONDS)
    said = [words for *_, words in recording.behind]
    recording.told("the server is killed and starts again", 2 * SECONDS)
    print(f"  the page says: {said or 'nothing'}")
    recording.picture(
        KEPT / f"page-link-{name}-killed-timeline.png",
        f"{name}: the server is killed after 2 s and starts again after 4 s",
    )
    visit.page.mouse.up()
    visit.ready()


def main():
    mbit, ms = sys.argv[1:3] if len(sys.argv) > 2 else ("5", "75")
    window = dict(zip(("width", "height"), map(int, sys.argv[3:5]))) or {
        "width": 1280,
        "height": 800,
    }
    store = tempfile.TemporaryDirectory()
    server = Server("--store", f"file:{store.name}/store")
    link = Link(server, mbit, ms)
    print(f"{mbit} Mbit/s, {ms} ms each way, a window of {window['width']} x {window['height']}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        for query in ("?plan=off", ""):
            name = "socket" if query else "plan"
            visit = opened(browser, link, query, window)
            print(f"{name}:")
            recording = drag(visit, visit.posed(0))
            recording.told(f"handles {visit['handles']}, lattice {visit['plan'] or 'off'}")
            recording.picture(
                KEPT / f"page-link-{name}-timeline.png",
                f"{name}: a drag at {mbit} Mbit/s, {ms} ms each way",
            )
            visit.keep(f"page-link-{name}")
            visit.page.mouse.up()
            visit.ready()
            # In a small window the panel is closed, which has the handles.
            if not query and visit.page.is_visible("#save-handles"):
                columns, rows = (int(c) for c in visit["plan"].split(","))
                found, residual, _ = distances(visit, columns, rows, visit.warp()["q"])
                middle, largest = found[len(found) // 2], found[-1]
                print(
                    f"  distance from the exact deformation: median {middle:.2f}, largest "
                    f"{largest:.2f}, residual {residual:.2f} px"
                )
            if not query:
                # The seventh point.
                visit.keys("Control+a", "Delete")
                for k in range(6):
                    visit.click(60 + 60 * k, 200 + 20 * (k % 3))
                visit.body("[data-handles='6']:not([data-plan=''])").ready()
                recording = Recording(visit)
                visit.click(30, 30)
                visit.page.wait_for_timeout(1500)
                recording.end()
                times = [
                    begin - recording.releases[0]
                    for begin, *_ in recording.plan
                    if begin > recording.releases[0]
                ]
                after = f"after {times[0]:.0f} ms" if times else "never"
                print(
                    f"  a seventh handle is posed without requests {after}, a table of "
                    f"{recording.table / 1000:.0f} kB"
                )
                recording.picture(
                    KEPT / "page-link-new-handle-timeline.png",
                    f"a new handle at {mbit} Mbit/s, {ms} ms each way",
                )
                visit.ready()
            without_the_server(visit, server, name)
            visit.close()
        browser.close()
    link.close()
    server.stop()
    store.cleanup()
    print(f"pictures: {KEPT.relative_to(ROOT)}/page-link-*.png")


if __name__ == "__main__":
    main()
