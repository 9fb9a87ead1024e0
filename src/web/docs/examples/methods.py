import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

for method in ["rigid", "similarity", "affine"]:
    warp = {
        "p": [[168, 112], [316, 136], [262, 240]],
        "q": [[140, 90], [345, 130], [262, 270]],
        "method": method,
        "alpha": 1.5,
        "output": {"format": "jpeg"},
    }
    answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"{method}.jpg", "wb").write(answer.content)
