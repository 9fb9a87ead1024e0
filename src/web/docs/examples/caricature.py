import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

# Landmarks of this face: eyes, mouth, nose; the same of the average face, aligned to this one.
face = [[168, 112], [316, 136], [262, 240], [270, 196]]
average = [[174, 112], [308, 132], [258, 232], [266, 192]]
# They keep the background in place.
corners = [[0, 0], [451, 0], [451, 300], [0, 300]]

for k in [0, 1.5]:  # 0: the average shape; 1: this face; above 1: a caricature
    moved = [[ax + k * (x - ax), ay + k * (y - ay)] for (x, y), (ax, ay) in zip(face, average)]
    warp = {"p": face + corners, "q": moved + corners}
    answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"shape-{k}.png", "wb").write(answer.content)
