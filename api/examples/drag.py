"""Drags one handle of a picture along a circle, as a hand would, and keeps the last frame.

    pip install httpx websockets
    python drag.py PICTURE OUT.png [http://127.0.0.1:8080]
"""

import asyncio
import json
import math
import sys

import httpx
from websockets.asyncio.client import connect

STEPS = 120


def pose(rest, step):
    """The first handle circles (60 px wide), the others stay."""
    (x, y), *others = rest
    angle = 2 * math.pi * step / STEPS
    return [[x + 30 * math.sin(angle), y + 30 - 30 * math.cos(angle)], *others]


async def move(socket, rest):
    """Says where the handles are, 125 times a second. Nobody waits for a frame: the server keeps the newest pose alone."""
    for step in range(STEPS):
        await socket.send(json.dumps({"seq": step, "q": pose(rest, step)}))
        await asyncio.sleep(1 / 125)


async def watch(socket):
    """Shows the frames and acknowledges each; the next comes after that. The last one is of the last pose, at full size."""
    frames = 0
    async for message in socket:
        if isinstance(message, str):
            told = json.loads(message)
            if "code" in told:
                raise RuntimeError(f"{told['code']}: {told['detail']}")
            report = told  # of the frame that follows
            continue
        seq, picture = int.from_bytes(message[:8], "little"), message[8:]
        await socket.send(json.dumps({"ack": seq}))
        frames += 1
        if seq == STEPS - 1 and report["full"]:
            print(f"{frames} frames for {STEPS} poses; the last is {report['width']} x {report['height']}")
            return picture


async def main(picture, out, server="http://127.0.0.1:8080"):
    async with httpx.AsyncClient(base_url=server) as http:
        # The picture is uploaded once, with the handles at rest.
        rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]]
        with open(picture, "rb") as file:
            answer = await http.post("/sessions", files={"image": file}, data={"warp": json.dumps({"p": rest})})
        answer.raise_for_status()
        session = answer.headers["Location"]
        # From here on nothing but q travels.
        address = server.replace("http", "ws", 1) + session + "/drag?frames=png&width=auto&report=true"
        async with connect(address, max_size=None) as socket:
            grid = json.loads(await socket.recv())
            print(f"{grid['width']} x {grid['height']}, {grid['columns']} x {grid['rows']} vertices")
            moving = asyncio.create_task(move(socket, rest))
            last = await watch(socket)
            await moving
        with open(out, "wb") as file:
            file.write(last)
        await http.delete(session)


asyncio.run(main(*sys.argv[1:]))
