"""Drags one handle of an image along a circle, as a user would, and saves the last frame.

    pip install httpx websockets        (Python 3.11 or later)
    python drag.py IMAGE OUT.png [http://127.0.0.1:8080]
"""

import asyncio
import json
import math
import sys
from pathlib import Path

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

STEPS = 120
PATIENCE = 5.0  # seconds without a message, after which the socket is given up


def pose(rest, step):
    """The first handle moves on a circle (60 px wide), the others stay."""
    (x, y), *others = rest
    angle = 2 * math.pi * step / STEPS
    return [[x + 30 * math.sin(angle), y + 30 - 30 * math.cos(angle)], *others]


async def move(socket, rest, hand):
    """Sends 125 poses per second without waiting for frames: the server keeps only the newest pose."""
    for hand["seq"] in range(hand["seq"], STEPS):
        await socket.send(json.dumps({"seq": hand["seq"], "q": pose(rest, hand["seq"])}))
        await asyncio.sleep(1 / 125)


async def watch(socket):
    """Acknowledges each frame; the server then sends the next one. The last frame has the last pose, at full size."""
    while True:
        message = await asyncio.wait_for(socket.recv(), PATIENCE)
        if isinstance(message, str):
            report = json.loads(message)  # the report of the next frame; the first message is the grid
            if "code" in report:
                raise RuntimeError(f"{report['code']}: {report['detail']}")
            continue
        seq, picture = int.from_bytes(message[:8], "little"), message[8:]
        await socket.send(json.dumps({"ack": seq}))
        if seq == STEPS - 1 and report["full"]:
            print(f"{STEPS} poses; the last frame is {report['width']} x {report['height']}")
            return picture


async def drag(address, rest):
    """If the socket closes or is silent, opens another one, which begins with the last pose sent."""
    hand = {"seq": 0}
    while True:
        try:
            async with connect(address.replace("http", "ws", 1), max_size=None, open_timeout=PATIENCE, close_timeout=1) as socket:
                moving = asyncio.create_task(move(socket, rest, hand))
                try:
                    return await watch(socket)
                finally:
                    moving.cancel()
                    await asyncio.gather(moving, return_exceptions=True)
        except (ConnectionClosed, TimeoutError) as gone:
            print(f"reconnecting: {gone!r}")
            await asyncio.sleep(0.2)


async def main(picture, out, server="http://127.0.0.1:8080"):
    async with httpx.AsyncClient(base_url=server) as http:
        # Upload the image once, with the handles at rest.
        rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]]
        parts = {"files": {"image": Path(picture).read_bytes()}, "data": {"warp": json.dumps({"p": rest})}}
        answer = (await http.post("/sessions", **parts)).raise_for_status()
        session = str(answer.url.join(answer.headers["Location"]))
        # From here on, only q is sent.
        Path(out).write_bytes(await drag(f"{session}/drag?frames=png&width=auto&report=true", rest))
        await http.delete(session)


asyncio.run(main(*sys.argv[1:]))
