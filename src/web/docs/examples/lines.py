import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

ground = [[0, 290], [225, 280], [451, 290]]  # a polyline: it stays where it is
warp = {"p": [[242, 185], ground], "q": [[242, 160], ground], "weights": [2, 1]}
answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
open("lines.png", "wb").write(answer.content)
