import json
import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

rest = {"p": [[168, 112], [316, 136], [262, 240]]}
created = server.post("/sessions", files={"image": image}, data={"warp": json.dumps(rest)})
if created.is_error:
    raise SystemExit(created.json()["detail"])
session = f"/sessions/{created.json()['id']}"

# Usually a mask or labels; here the image itself.
stored = server.put(f"{session}/layers/copy", content=image)
if stored.is_error:
    raise SystemExit(stored.json()["detail"])

for layer in ["copy", "@coverage"]:
    pose = {"q": [[150, 104], [338, 126], [262, 262]], "layer": layer}
    answer = server.post(f"{session}/warp", json=pose)
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"layer-{layer}.png", "wb").write(answer.content)

server.delete(session).raise_for_status()
