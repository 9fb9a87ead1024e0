import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

warp = {
    "p": [[168, 112], [316, 136]],
    "q": [[120, 112], [316, 136]],
    "output": {"format": "jpeg", "quality": 80, "width": 225, "outside": "edge"},
}
answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
open("small.jpg", "wb").write(answer.content)
