import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

face = [[168, 112], [316, 136], [262, 240], [270, 196]]  # landmarks of this face: eyes, mouth, nose
average = [
    [174, 112],
    [308, 132],
    [258, 232],
    [266, 192],
]  # the same landmarks of the average face, aligned to this one
corners = [[0, 0], [451, 0], [451, 300], [0, 300]]  # keep the background in place

for k in [0, 1.5]:  # 0: the average shape; 1: this face; above 1: a caricature
    moved = [[ax + k * (x - ax), ay + k * (y - ay)] for (x, y), (ax, ay) in zip(face, average)]
    warp = {"p": face + corners, "q": moved + corners}
    answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"shape-{k}.png", "wb").write(answer.content)
