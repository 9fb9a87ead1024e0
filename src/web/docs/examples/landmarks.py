import csv
import io
import json


def pts(text):
    """ibug and 300-W .pts: pixel indices that count from 1."""
    inside = text[text.index("{") + 1 : text.index("}")]
    return [[float(x) - 0.5, float(y) - 0.5] for x, y in (line.split() for line in inside.split("\n") if line.strip())]


def pixel_indices(points):
    """OpenCV, dlib: pixel indices that count from 0."""
    return [[x + 0.5, y + 0.5] for x, y in points]


def table(text):
    """CSV with the columns px,py,qx,qy, in px."""
    rows = list(csv.DictReader(io.StringIO(text)))
    p = [[float(row["px"]), float(row["py"])] for row in rows]
    return {"p": p, "q": [[float(row["qx"]), float(row["qy"])] for row in rows]}


def normalized(landmarks):
    """MediaPipe: objects with x and y from 0 to 1."""
    return {"p": [[point["x"], point["y"]] for point in landmarks], "units": "normalized"}


print(json.dumps({"p": pts("version: 1\nn_points: 2\n{\n169 113\n317 137\n}\n")}))
print(json.dumps(table("px,py,qx,qy\n168.5,112.5,150,104\n316.5,136.5,338,126\n")))
print(json.dumps(normalized([{"x": 0.37, "y": 0.37, "z": 0}])))
print(json.dumps({"p": pixel_indices([[168, 112], [316, 136]])}))
