"""Clients that drag, and one that uploads. Each records its responses and their times."""

import http.client
import json
import math
import threading
import time
import uuid
from dataclasses import dataclass, field

from commands import ROOT, Failure
from websocket import BINARY, TEXT, Closed, Refused, WebSocket

# Frames per second of a dragging client, and poses per cycle.
RATE, POSES = 15, 12
# Seconds before a rejected client retries.
PAUSE = 0.1
PATIENCE = 10.0
# Servers close idle connections after ten seconds.
KEPT = 5.0
PREVIEW_WIDTH = 256
PICTURES = ROOT / "tests" / "images"


def multipart(picture, warp):
    """(body, content type) of an upload."""
    boundary = uuid.uuid4().hex
    part = f"--{boundary}\r\n" + 'Content-Disposition: form-data; name="{}"{}\r\n\r\n'
    body = part.format("image", '; filename="picture"').encode() + picture + b"\r\n"
    body += (
        part.format("warp", "").encode()
        + json.dumps(warp).encode()
        + f"\r\n--{boundary}--\r\n".encode()
    )
    return body, f"multipart/form-data; boundary={boundary}"


def reason(answer):
    """The reason from a problem document, if there is one."""
    try:
        return json.loads(answer)["detail"]
    except (ValueError, KeyError, TypeError):
        return f"no problem document: {answer[:200]!r}"


@dataclass
class Entry:
    """One response: `what` is `frame`, `upload`, `wrong` (another image), `refused`, `cut`
    (incomplete) or `closed` (a socket)."""

    what: str
    at: float
    detail: object = None


@dataclass
class Server:
    """The address of the service."""

    host: str
    port: int
    kept: threading.local = field(default_factory=threading.local)

    def ask(self, method, path, body=None, kind="application/json", headers=None):
        """(status, headers, body), over the connection of the thread; failures are OSError or
        HTTPException."""
        # A connection that was idle for long may be closed at any moment, which is not a failure.
        if (
            getattr(self.kept, "connection", None) is None
            or time.monotonic() - self.kept.used > KEPT
        ):
            self.kept.connection = http.client.HTTPConnection(
                self.host, self.port, timeout=PATIENCE
            )
        self.kept.used = time.monotonic()
        try:
            self.kept.connection.request(
                method,
                path,
                body,
                {**({"Content-Type": kind} if body is not None else {}), **(headers or {})},
            )
            answer = self.kept.connection.getresponse()
            return answer.status, answer.headers, answer.read()
        except BaseException:
            self.kept.connection.close()
            self.kept.connection = None
            raise

    def json(self, method, path, expected, body=None, kind="application/json"):
        status, _, answered = self.ask(method, path, body, kind)
        if status not in expected:
            raise Failure(f"{method} {path} at {self.host} answered {status}: {answered[:300]!r}")
        return json.loads(answered)


class DragClient:
    """Drags its own image by its own handles, in cycles."""

    def __init__(self, name, picture, shift):
        self.name, self.picture, self.shift = name, picture, shift
        self.session = str(uuid.uuid4())
        # The last pose sent, and the last one answered.
        self.record, self.seq, self.answered = [], 0, 0
        self.file = (PICTURES / picture).read_bytes()

    def note(self, what, detail=None):
        self.record.append(Entry(what, time.monotonic(), detail))

    def learn(self, lone):
        """The expected image of each pose, from an undisturbed server."""
        width, height = self._size(lone)
        inner = [(0.3 + self.shift, 0.35), (0.65, 0.4 + self.shift), (0.5, 0.7 - self.shift)]
        corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
        self.rest = [[x * width, y * height] for x, y in inner + corners]
        circle = [2 * math.pi * i / POSES for i in range(POSES)]
        moves = [
            (0.06 * width * math.cos(angle), 0.06 * height * math.sin(angle)) for angle in circle
        ]
        self.poses = [
            [[x + dx, y + dy] if i == 0 else [x, y] for i, (x, y) in enumerate(self.rest)]
            for dx, dy in moves
        ]
        self.put(lone)
        self.expected = self._expected_frames(lone)
        if len(set.union(*self.expected)) < POSES * self.views:
            raise Failure(
                f"two poses of {self.picture} look the same: nothing could be told from them"
            )

    def _size(self, lone):
        # Handles are in pixels: a session without handles returns the size.
        body, kind = multipart(self.file, {"p": []})
        image = lone.json("POST", "/sessions", (201,), body, kind)["image"]
        return image["width"], image["height"]

    def put(self, server):
        body, kind = multipart(self.file, {"p": self.rest})
        server.json("PUT", f"/sessions/{self.session}", (200, 201), body, kind)

    def question(self):
        """The current pose."""
        return json.dumps({"seq": self.seq, "q": self.poses[self.seq % POSES]})

    def compare(self, seq, picture, plan=None):
        right = picture in self.expected[seq % POSES]
        self.answered = seq
        self.note("frame" if right else "wrong", plan if right else (seq, len(picture)))


class RequestClient(DragClient):
    """Drags with `POST /sessions/{id}/warp`, one request at a time."""

    views = 1

    def _expected_frames(self, lone):
        expected = []
        for pose in self.poses:
            status, _, body = lone.ask(
                "POST", f"/sessions/{self.session}/warp", json.dumps({"q": pose})
            )
            if status != 200:
                raise Failure(f"the lone server answered {status}: {body[:300]!r}")
            expected.append({body})
        return expected

    def drag(self, server, stop):
        due = time.monotonic()
        while not stop.is_set():
            time.sleep(max(0.0, due - time.monotonic()))
            due = max(due + 1 / RATE, time.monotonic())
            self.seq += 1
            while not self._ask(server) and not stop.is_set():
                pass

    def once(self, server, session=None, headers=None):
        """(status, whether the image is correct, `Warp-Plan`) of the next pose; the session id may
        be spelled differently."""
        self.seq += 1
        try:
            status, said, body = server.ask(
                "POST",
                f"/sessions/{session or self.session}/warp",
                self.question(),
                headers=headers,
            )
        except (OSError, http.client.HTTPException) as error:
            return repr(error), False, None
        return status, body in self.expected[self.seq % POSES], said["Warp-Plan"]

    def _ask(self, server):
        """Whether there was a response: a cut-off request is repeated with the same seq."""
        try:
            status, headers, answer = server.ask(
                "POST", f"/sessions/{self.session}/warp", self.question()
            )
        except (OSError, http.client.HTTPException) as error:
            self.note("cut", repr(error))
            return False
        if status == 200:
            self.compare(self.seq, answer, headers["Warp-Plan"])
        else:
            self.note("refused", (status, headers["Retry-After"], reason(answer)))
            time.sleep(PAUSE)
        return True


class SocketClient(DragClient):
    """Drags with the socket; reopens it when it is closed, like the page."""

    # Previews, and the full image when the pointer rests.
    views = 2

    def open(self, server, more=""):
        return WebSocket(
            server.host,
            server.port,
            f"/sessions/{self.session}/drag?frames=png&width={PREVIEW_WIDTH}{more}",
        )

    def _expected_frames(self, lone):
        line, expected = self.open(lone, "&report=true"), []
        for seq, pose in enumerate(self.poses):
            line.send(json.dumps({"seq": seq, "q": pose}).encode())
            seen, full = set(), False
            # The preview, and the full image after a pause.
            while len(seen) < self.views or not full:
                kind, message = line.receive(time.monotonic() + PATIENCE) or (None, b"")
                if kind is None:
                    raise Failure(f"the lone server showed {len(seen)} pictures of a pose")
                if kind == TEXT:
                    full = json.loads(message).get("full", full)
                else:
                    seen.add(message[8:])
                    line.send(json.dumps({"ack": seq}).encode())
            expected.append(seen)
        line.close()
        return expected

    def once(self, server):
        """(a frame, is it the right picture) of the next pose, over a socket of its own; no frame
        is b""."""
        self.seq += 1
        line, kind, frame = self.open(server), TEXT, b""
        line.send(self.question().encode())
        while kind == TEXT:
            kind, frame = line.receive(time.monotonic() + PATIENCE) or (None, b"")
        line.close()
        return frame, frame[8:] in self.expected[self.seq % POSES]

    def drag(self, server, stop):
        while not stop.is_set():
            try:
                self._hold(self.open(server), stop)
            except Closed as closed:
                self.note("closed", closed.code)
            except Refused as refused:
                self.note(
                    "refused", (refused.status, refused.headers.get("retry-after"), "a socket")
                )
                time.sleep(PAUSE)
            except OSError as error:
                self.note("cut", repr(error))
                time.sleep(PAUSE)

    def _hold(self, line, stop):
        due = time.monotonic()
        while not stop.is_set():
            if time.monotonic() >= due:
                due = max(due + 1 / RATE, time.monotonic())
                self.seq += 1
                line.send(self.question().encode())
            kind, message = line.receive(due) or (None, b"")
            if kind == BINARY:
                seq = int.from_bytes(message[:8], "little")
                line.send(json.dumps({"ack": seq}).encode())
                self.compare(seq, message[8:])
            elif kind == TEXT and "code" in (said := json.loads(message)):
                self.note("refused", (said.get("status"), said.get("retry_after"), reason(message)))
        line.close()


class Uploader:
    """Uploads a small image about once per second, alternating POST and PUT, and records the
    confirmed sessions."""

    name = "uploads"

    def __init__(self):
        self.file = (PICTURES / "horse.png").read_bytes()
        self.record, self.promised = [], []

    def note(self, what, detail=None):
        self.record.append(Entry(what, time.monotonic(), detail))

    def drag(self, server, stop):
        turn = 0
        while not stop.wait(1.0):
            turn += 1
            body, kind = multipart(self.file, {"p": [[10 + turn, 20], [100, 120]]})
            way = ("POST", "/sessions") if turn % 2 else ("PUT", f"/sessions/{uuid.uuid4()}")
            try:
                status, headers, answer = server.ask(*way, body, kind)
            except (OSError, http.client.HTTPException) as error:
                self.note("cut", repr(error))
                continue
            if status in (200, 201):
                self.promised.append(json.loads(answer)["id"])
                self.note("upload")
            else:
                self.note("refused", (status, headers["Retry-After"], reason(answer)))
