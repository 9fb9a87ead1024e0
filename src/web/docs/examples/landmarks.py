import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

# ibug .pts counts from 1
rest = "version: 1\nn_points: 3\n{\n168.5 112.5\n316.5 136.5\n262.5 240.5\n}\n"
posed = "x,y\n150,104\n338,126\n262,262\n"  # CSV in px
answer = server.post("/warp", files={"image": image, "landmarks_p": rest, "landmarks_q": posed})
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
open("landmarks.png", "wb").write(answer.content)


def from_pixel_indices(points):
    """From OpenCV or dlib in your own program: add 0.5."""
    return [[x + 0.5, y + 0.5] for x, y in points]


print({"p": from_pixel_indices([[168, 112], [316, 136]])})
