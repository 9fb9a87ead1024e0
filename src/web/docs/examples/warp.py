import json

import httpx  # pip install httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

warp = {"p": [[168, 112], [316, 136], [262, 240]], "q": [[150, 104], [338, 126], [262, 262]]}
answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
open("warped.png", "wb").write(answer.content)
