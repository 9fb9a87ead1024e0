import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

rest = {"p": [[168, 112], [316, 136], [262, 240]]}
created = server.post("/sessions", files={"image": image}, data={"warp": json.dumps(rest)})
if created.is_error:
    raise SystemExit(created.json()["detail"])
session = f"/sessions/{created.json()['id']}"

for seq, x in enumerate([150, 140, 130]):
    pose = {"seq": seq, "q": [[x, 104], [338, 126], [262, 262]]}
    answer = server.post(f"{session}/warp", json=pose)
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"drag-{x}.png", "wb").write(answer.content)

server.delete(session).raise_for_status()
