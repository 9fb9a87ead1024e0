"""Drags one handle of an image along a circle, as a user would, and saves the last frame.

    pip install httpx websockets        (Python 3.11 or later)
    python drag.py IMAGE OUT.png [http://127.0.0.1:8080] [--key KEY]

A server with keys needs one: --key, or the variable MLSWARP_KEY, which no other user of the machine
can see.
"""

import argparse
import asyncio
import json
import math
import os
import sys
from pathlib import Path

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

STEPS = 120
PATIENCE = 5.0  # seconds without a message, after which the socket is given up


def failure(status, body):
    """What the server says about a request that failed: a problem document (RFC 9457)."""
    try:
        problem = json.loads(body)
        return f"{problem['code']}: {problem['detail']}"
    except (ValueError, TypeError, KeyError):
        # Something else is there, for example a proxy.
        return f"the server answered {status}: {body[:200]!r}"


def checked(answer):
    return answer if answer.is_success else sys.exit(failure(answer.status_code, answer.content))


def pose(rest, step):
    """The first handle moves on a circle (60 px wide), the others stay."""
    (x, y), *others = rest
    angle = 2 * math.pi * step / STEPS
    return [[x + 30 * math.sin(angle), y + 30 - 30 * math.cos(angle)], *others]


async def move(socket, rest, progress):
    """Sends 125 poses per second without waiting for frames: the server keeps only the newest
    pose."""
    for seq in range(progress["seq"], STEPS):
        progress["seq"] = seq
        await socket.send(json.dumps({"seq": seq, "q": pose(rest, seq)}))
        await asyncio.sleep(1 / 125)


async def watch(socket):
    """Acknowledges each frame; the server then sends the next one. The last frame has the last
    pose, at full size."""
    while True:
        message = await asyncio.wait_for(socket.recv(), PATIENCE)
        if isinstance(message, str):
            report = json.loads(
                message
            )  # the report of the next frame; the first message is the grid
            if "code" in report:
                sys.exit(failure(None, message))
            continue
        seq, picture = int.from_bytes(message[:8], "little"), message[8:]
        await socket.send(json.dumps({"ack": seq}))
        if seq == STEPS - 1 and report["full"]:
            print(f"{STEPS} poses; the last frame is {report['width']} x {report['height']}")
            return picture


async def drag(address, headers, rest):
    """If the socket closes or is silent, opens another one, which begins with the last pose
    sent."""
    progress = {"seq": 0}
    for _ in range(20):
        try:
            url = address.replace("http", "ws", 1)
            async with connect(
                url,
                additional_headers=headers,
                max_size=None,
                open_timeout=PATIENCE,
                close_timeout=1,
            ) as socket:
                moving = asyncio.create_task(move(socket, rest, progress))
                try:
                    return await watch(socket)
                finally:
                    moving.cancel()
                    await asyncio.gather(moving, return_exceptions=True)
        except InvalidStatus as refused:
            sys.exit(failure(refused.response.status_code, refused.response.body))
        except (ConnectionClosed, OSError) as gone:  # a TimeoutError is an OSError
            print(f"reconnecting: {gone!r}")
            await asyncio.sleep(0.2)
    sys.exit("the server does not answer any more")


async def main(image, out, server, key):
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    async with httpx.AsyncClient(base_url=server, headers=headers) as http:
        # Upload the image once, with the handles at rest.
        rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]]
        parts = {"files": {"image": image.read_bytes()}, "data": {"warp": json.dumps({"p": rest})}}
        answer = checked(await http.post("/sessions", **parts))
        session = str(answer.url.join(answer.headers["Location"]))
        # From here on, only q is sent.
        out.write_bytes(
            await drag(f"{session}/drag?frames=png&width=auto&report=true", headers, rest)
        )
        await http.delete(session)


options = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
options.add_argument("image", type=Path)
options.add_argument("out", type=Path)
options.add_argument(
    "server", nargs="?", default="http://127.0.0.1:8080", type=lambda url: url.rstrip("/")
)
options.add_argument("--key", default=os.environ.get("MLSWARP_KEY"))
given = options.parse_args()
try:
    asyncio.run(main(**vars(given)))
except (httpx.TransportError, httpx.InvalidURL) as error:
    sys.exit(f"cannot reach {given.server}: {error}")
except OSError as error:  # a file
    sys.exit(str(error))
