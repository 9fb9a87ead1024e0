"""The relay of tests/link between the page and a server, and a record of what the page shows and
sends over it."""

import json
import math
import subprocess
from pathlib import Path

from support import PROGRAM, Visited

LINK = Path(PROGRAM).parent / "examples" / "link"


class Link(Visited):
    """A server at the other end of a link of MBIT Mbit/s and MS ms each way."""

    def __init__(self, server, mbit=5, ms=75):
        assert LINK.exists(), f"{LINK} does not exist: cargo build --locked --example link"
        self.ask = server.ask
        command = [LINK, f"127.0.0.1:{server.port}", str(mbit), str(ms)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.address = f"http://127.0.0.1:{self.process.stdout.readline().strip()}"

    def tell(self, command):
        self.process.stdin.write(f"{command}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "ok\n", command

    def rate(self, mbit):
        self.tell(f"rate {mbit}")

    def pause(self, seconds):
        """Nothing passes for this time."""
        self.tell(f"pause {seconds}")

    def close(self):
        self.leave()
        self.process.stdin.close()
        self.process.wait()


# `wrong`: what the page may never show, by its own clock, however slow the machine is. `waits`: for
# each pose that the socket sends, how long the oldest unanswered one had waited, beyond the
# quickest response so far. `unacknowledged`: most frames that the page had received and not
# acknowledged.
RECORD = """(() => {
  const seen = (window.seen = { wrong: [], waits: [], unacknowledged: 0, poses: 0 });
  window.WebSocket = class extends WebSocket {
    #unanswered = new Map();
    #frames = new Set();
    #quickest = Infinity;

    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => {
        if (typeof data === "string") return;
        const seq = Number(new DataView(data).getBigUint64(0, true));
        this.#frames.add(seq);
        seen.unacknowledged = Math.max(seen.unacknowledged, this.#frames.size);
        const sent = this.#unanswered.get(seq);
        if (sent !== undefined) this.#quickest = Math.min(this.#quickest, performance.now() - sent);
        for (const old of this.#unanswered.keys()) if (old <= seq) this.#unanswered.delete(old);
      });
    }

    send(text) {
      super.send(text);
      const { ack, seq } = JSON.parse(text);
      for (const frame of this.#frames) if (frame <= ack) this.#frames.delete(frame);
      if (seq === undefined) return;
      seen.poses += 1;
      const [oldest] = this.#unanswered.values();
      const least = Number.isFinite(this.#quickest) ? this.#quickest : 300;
      if (oldest !== undefined) seen.waits.push(performance.now() - oldest - least);
      this.#unanswered.set(seq, performance.now());
    }
  };
  const poses = []; // [revision, time], those newer than the shown one
  let last = 0;
  const look = () => {
    const { dataset } = document.body;
    const [revision, shown] = [Number(dataset.revision), Number(dataset.shown || 0)];
    const now = performance.now();
    if (poses.at(-1)?.[0] !== revision) poses.push([revision, now]);
    while (poses.length && poses[0][0] <= shown) poses.shift();
    const age = poses.length ? now - poses[0][1] : 0;
    const told = JSON.stringify(dataset);
    if (shown < last) seen.wrong.push(`older than before: ${told}`);
    if (shown > revision) seen.wrong.push(`a pose of the future: ${told}`);
    const isDone = shown === revision && dataset.source === "png";
    if (dataset.state === "ready" && !isDone) seen.wrong.push(`ready too early: ${told}`);
    // Half a second for a busy machine, on which timers and frames are late.
    if (age > 1500 && dataset.state === "busy" && !dataset.behind)
      seen.wrong.push(`${age} ms behind without a word: ${told}`);
    const words = document.getElementById("behind").textContent;
    if (Boolean(dataset.behind) !== Boolean(words)) seen.wrong.push(`other words: ${told}`);
    last = shown;
    requestAnimationFrame(look);
  };
  addEventListener("DOMContentLoaded", () => requestAnimationFrame(look));
})()"""


def recorded(visit):
    """Begins the record; the page is loaded again."""
    visit.page.add_init_script(RECORD)
    visit.page.reload()
    visit.body("[data-webgl]")
    return visit


def vertices(handle):
    return handle if isinstance(handle[0], list) else [handle]


def distances(visit, columns, rows, q):
    """
    How far the drawing by a lattice is from the deformation at dense points, px, ascending; the
    residual that the page computes; and the largest distance at the handles themselves.
    """
    warp = visit.warp()
    wide, high = (int(float(c)) for c in visit["canvas"].split(",")[2:])
    points = [
        [(i + 0.5) * wide / 120, (j + 0.5) * high / 90] for j in range(90) for i in range(120)
    ]
    # The handles, where the drawing is worst.
    places = [
        [place for handle in handles for place in vertices(handle)] for handles in (warp["p"], q)
    ]
    points += places[0]
    drawn, residual = visit.page.evaluate(
        """async ([id, columns, rows, p, q, points]) => {
          const { plan } = await import("./page/api.js");
          const { Plan } = await import("./page/plan.js");
          const table = new Plan(await plan(id, columns, rows));
          const mesh = table.pose(p, q);
          return [points.map(([x, y]) => mesh.forward(x, y)), table.residual(mesh, p, q)];
        }""",
        [visit["session"], columns, rows, warp["p"], q, points],
    )
    exact = json.loads(
        visit.server.ask(
            "POST", f"/sessions/{visit['session']}/points", {"q": q, "points": points}
        ).body
    )["points"]
    at_handles = max(
        math.dist(a, b) for a, b in zip(places[1], drawn[-len(places[1]) :], strict=True) if b
    )
    return (
        sorted(math.dist(a, b) for a, b in zip(exact, drawn, strict=True) if b),
        residual,
        at_handles,
    )
