import asyncio
import json

import httpx
from websockets.asyncio.client import connect  # pip install websockets

address = "http://127.0.0.1:8080"


async def main():
    async with httpx.AsyncClient(base_url=address) as server:
        image = (await server.get("/page/cat.jpg")).raise_for_status().content
        rest = {"p": [[168, 112], [316, 136], [262, 240]]}
        created = await server.post(
            "/sessions", files={"image": image}, data={"warp": json.dumps(rest)}
        )
        if created.is_error:
            raise SystemExit(created.json()["detail"])
        session = created.json()["id"]
        url = f"{address.replace('http', 'ws', 1)}/sessions/{session}/drag?frames=jpeg"
        async with connect(url, max_size=None) as socket:
            print("grid", json.loads(await socket.recv()))
            for seq in range(10):
                await socket.send(
                    json.dumps({"seq": seq, "q": [[168 - 3 * seq, 112], [316, 136], [262, 240]]})
                )
            seen = -1
            while seen < 9:
                frame = await socket.recv()
                if isinstance(frame, str):  # a problem document
                    raise SystemExit(frame)
                seen = int.from_bytes(frame[:8], "little")
                await socket.send(json.dumps({"ack": seen}))
            open("frame.jpg", "wb").write(frame[8:])
        await server.delete(f"/sessions/{session}")


asyncio.run(main())
