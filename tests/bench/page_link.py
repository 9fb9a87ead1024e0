#!/usr/bin/env python3
"""The page behind a slow link: frames drawn during a drag, the reaction to the first movement, the time until a new handle is posed locally, and a
drag during which the server ends.

    tests/e2e/run -k nothing                     # creates the environment
    cargo build --release --locked -p mlswarp-server --bin mlswarp --example link
    MLSWARP_PROGRAM=target/release/mlswarp tests/artefacts/e2e/venv/bin/python tests/bench/page_link.py [MBIT MS]

The link has MBIT Mbit/s (5) and MS ms each way (75). A frame is a display frame in which another pose was drawn. Each figure is printed with the
coefficients and with `?plan=off`, where meshes come by the socket. Screenshots are in tests/artefacts/e2e.
"""

import math
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
os.environ.setdefault("MLSWARP_PROGRAM", str(ROOT / "target" / "release" / "mlswarp"))
os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"

from playwright.sync_api import sync_playwright

from support import CHROMIUM, FLAGS, KEPT, SOCKET, Server, Visit

LINK = Path(os.environ["MLSWARP_PROGRAM"]).parent / "examples" / "link"
SECONDS = 3
# `poses`: when another pose was drawn; `reaction`: ms from the first movement to the frame of its pose; `plan`: when coefficients arrived.
WATCH = """() => {
  const { dataset } = document.body;
  const seen = (window.seen = { moved: null, poses: [], reaction: null, plans: [] });
  addEventListener("pointermove", ({ timeStamp }) => (seen.moved ??= timeStamp), { capture: true });
  let [shown, plan] = [dataset.shown, dataset.plan];
  const look = () => {
    if (dataset.shown !== shown && dataset.moving === "true") {
      seen.poses.push(performance.now());
      seen.reaction ??= performance.now() - seen.moved;
    }
    if (dataset.plan !== plan && dataset.plan) seen.plans.push(performance.now());
    [shown, plan] = [dataset.shown, dataset.plan];
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


def drag(visit, start, during=lambda share: None):
    """Moves a handle on a circle; returns what the page has recorded."""
    visit.page.mouse.move(*visit.at(*start))
    visit.page.mouse.down()
    visit.page.evaluate(WATCH)
    begun = time.monotonic()
    while (share := (time.monotonic() - begun) / SECONDS) < 1:
        angle = 4 * math.pi * share
        visit.page.mouse.move(*visit.at(start[0] + 25 * math.sin(angle), start[1] + 25 - 25 * math.cos(angle)))
        during(share)
    return visit.page.evaluate("window.seen")


def told(name, seen):
    gaps = [b - a for a, b in zip(seen["poses"], seen["poses"][1:])]
    longest = max(gaps, default=float("nan"))
    print(f"{name}: {len(seen['poses']) / SECONDS:.0f} frames/s, first after {seen['reaction'] or float('nan'):.0f} ms, longest gap {longest:.0f} ms")


def main():
    mbit, ms = sys.argv[1:3] if len(sys.argv) > 2 else ("5", "75")
    server = Server()
    relay = subprocess.Popen([LINK, f"127.0.0.1:{server.port}", mbit, ms], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    far = SimpleNamespace(address=f"http://127.0.0.1:{relay.stdout.readline().strip()}", ask=server.ask)
    print(f"{mbit} Mbit/s, {ms} ms each way")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS, "--disable-gpu-rasterization"])
        for query in ("?plan=off", ""):
            visit = Visit(browser, far, query=query, expects=(SOCKET, "404", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE", "ERR_CONNECTION_REFUSED"))
            visit.sample("cat")
            handle = visit.posed(0)
            told(f"handles {visit['handles']}, lattice {visit['plan'] or 'off'}", drag(visit, handle))
            visit.keep(f"page-link{'-plan' if not query else ''}")
            visit.page.mouse.up()
            visit.ready()
            if query:
                visit.close()
                continue
            visit.page.evaluate(WATCH)
            clicked = visit.page.evaluate("performance.now()")
            visit.click(30, 30)
            visit.body(f"[data-plan]:not([data-plan=''])[data-handles='{int(visit['handles'])}']")
            visit.page.wait_for_timeout(1500)
            plans = visit.page.evaluate("window.seen.plans")
            print(f"a new handle: coefficients after {plans[0] - clicked:.0f} ms" if plans else "a new handle: no coefficients")
            visit.ready()

            def end(share):
                if share > 0.5 and server.process.poll() is None:
                    server.process.kill()
                    server.process.wait()

            told("the server ends in the middle", drag(visit, visit.posed(0), end))
            print(f"the page says: {visit.text('behind') or 'nothing'}")
            visit.keep("page-link-without-a-server")
            visit.close()
        browser.close()
    relay.kill()
    server.kill()
    print(f"screenshots: {KEPT.relative_to(ROOT)}/page-link*.png")


main()
