import io
import json

import httpx  # pip install httpx pillow
from PIL import Image, ImageDraw

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

rest = {"p": [[168, 112], [316, 136], [262, 240]]}
created = server.post("/sessions", files={"image": image}, data={"warp": json.dumps(rest)})
if created.is_error:
    raise SystemExit(created.json()["detail"])
session = f"/sessions/{created.json()['id']}"

# A mask of the face: 255 inside, 0 outside.
mask, file = Image.new("L", Image.open(io.BytesIO(image)).size), io.BytesIO()
ImageDraw.Draw(mask).ellipse([120, 60, 380, 290], fill=255)
mask.save(file, "png")

# As labels, which follow the warp, and as the region, outside of which nothing moves.
for layer in ["face?kind=labels", "region"]:
    stored = server.put(f"{session}/layers/{layer}", content=file.getvalue())
    if stored.is_error:
        raise SystemExit(stored.json()["detail"])

for layer in [None, "face", "@holes"]:
    pose = {"q": [[128, 112], [276, 136], [222, 240]], "layer": layer}
    answer = server.post(f"{session}/warp", json=pose)
    if answer.is_error:
        raise SystemExit(answer.json()["detail"])
    open(f"layer-{layer or 'image'}.png", "wb").write(answer.content)

server.delete(session).raise_for_status()
