import asyncio
import json
import struct

import httpx
from websockets.asyncio.client import connect  # pip install websockets

address = "http://127.0.0.1:8080"


def read(frame, grid):
    """The posed vertices, row by row, px."""
    (scale,) = struct.unpack_from("<f", frame, 8)
    units = struct.iter_unpack("<2h", frame[12:])
    xs = [k * grid["cell"][0] for k in range(grid["columns"] - 1)] + [grid["width"]]
    ys = [k * grid["cell"][1] for k in range(grid["rows"] - 1)] + [grid["height"]]
    return [
        (x + scale * dx, y + scale * dy)
        for (x, y), (dx, dy) in zip(((x, y) for y in ys for x in xs), units)
    ]


async def main():
    async with httpx.AsyncClient(base_url=address) as server:
        image = (await server.get("/page/cat.jpg")).raise_for_status().content
        rest = {"p": [[168, 112], [316, 136], [262, 240]]}
        created = (
            await server.post("/sessions", files={"image": image}, data={"warp": json.dumps(rest)})
        ).raise_for_status()
        session = created.json()["id"]
        url = f"{address.replace('http', 'ws', 1)}/sessions/{session}/drag"
        url += "?frames=mesh&mesh=compact&tolerance=1"
        async with connect(url) as socket:
            grid = json.loads(await socket.recv())
            await socket.send(json.dumps({"seq": 1, "q": [[150, 104], [338, 126], [262, 240]]}))
            frame = await socket.recv()
            if isinstance(frame, str):  # a problem document
                raise SystemExit(frame)
            vertices = read(frame, grid)
            print(len(frame), "bytes,", len(vertices), "vertices; the first is at", *vertices[0])
            await socket.send(json.dumps({"ack": 1}))  # the next frame is sent after this
        await server.delete(f"/sessions/{session}")


asyncio.run(main())
