"""Drags one handle of a picture along a circle, as a hand would, and keeps the last frame.

    pip install httpx websockets        (Python 3.11 or later)
    python drag.py PICTURE OUT.png [http://127.0.0.1:8080]
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
PATIENCE = 5.0  # seconds: whoever answers nothing for so long is gone, whatever the connection says


def pose(rest, step):
    """The first handle circles (60 px wide), the others stay."""
    (x, y), *others = rest
    angle = 2 * math.pi * step / STEPS
    return [[x + 30 * math.sin(angle), y + 30 - 30 * math.cos(angle)], *others]


async def move(socket, rest, hand):
    """Says where the handles are, 125 times a second. Nobody waits for a frame: the server keeps the newest pose alone."""
    for hand["seq"] in range(hand["seq"], STEPS):
        await socket.send(json.dumps({"seq": hand["seq"], "q": pose(rest, hand["seq"])}))
        await asyncio.sleep(1 / 125)


async def watch(socket):
    """Shows the frames and acknowledges each; the next comes after that. The last one is of the last pose, at full size."""
    while True:
        message = await asyncio.wait_for(socket.recv(), PATIENCE)
        if isinstance(message, str):
            report = json.loads(message)  # of the frame that follows; the first one tells the grid
            if "code" in report:
                raise RuntimeError(f"{report['code']}: {report['detail']}")
            continue
        seq, picture = int.from_bytes(message[:8], "little"), message[8:]
        await socket.send(json.dumps({"ack": seq}))
        if seq == STEPS - 1 and report["full"]:
            print(f"{STEPS} poses; the last frame is {report['width']} x {report['height']}")
            return picture


async def drag(address, rest):
    """A socket that ends, or answers nothing, is given up; the next one begins with the pose that was sent last."""
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
            print(f"another socket, as this one is gone: {gone!r}")
            await asyncio.sleep(0.2)


async def main(picture, out, server="http://127.0.0.1:8080"):
    async with httpx.AsyncClient(base_url=server) as http:
        # The picture is uploaded once, with the handles at rest.
        rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]]
        parts = {"files": {"image": Path(picture).read_bytes()}, "data": {"warp": json.dumps({"p": rest})}}
        session = (await http.post("/sessions", **parts)).raise_for_status().headers["Location"]
        # From here on nothing but q travels.
        Path(out).write_bytes(await drag(f"{server}{session}/drag?frames=png&width=auto&report=true", rest))
        await http.delete(session)


asyncio.run(main(*sys.argv[1:]))
