import io
import json
import pathlib
import zipfile

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content
# Labels as YOLO has them: class, centre and size of each box, as shares of the image.
labels = [[0, 0.37, 0.35, 0.11, 0.17], [0, 0.69, 0.43, 0.10, 0.13]]

created = server.post(
    "/sessions", files={"image": image}, data={"warp": json.dumps({"units": "normalized"})}
)
if created.is_error:
    raise SystemExit(created.json()["detail"])
session = f"/sessions/{created.json()['id']}"

answer = server.post(
    f"{session}/batch",
    timeout=60,
    json={
        "jitter": {"seed": 7, "count": 20, "sigma": 4},
        "output": {"format": "jpeg"},
        "boxes": [[x - w / 2, y - h / 2, x + w / 2, y + h / 2] for _, x, y, w, h in labels],
    },
)
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
server.delete(session).raise_for_status()

folder = pathlib.Path("augmented")
with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
    archive.extractall(folder)
for file in sorted(folder.glob("[0-9]*.json")):
    rows = []
    for (kind, *_), box in zip(labels, json.loads(file.read_text())["boxes"]):
        left, top, right, bottom = [min(max(share, 0), 1) for share in box]
        rows.append(
            f"{kind} {(left + right) / 2} {(top + bottom) / 2} {right - left} {bottom - top}\n"
        )
    file.with_suffix(".txt").write_text("".join(rows))
print(len(list(folder.glob("*.jpg"))), "pictures with labels in", folder)
