import json
import struct

import httpx
import numpy as np  # pip install numpy


def pose(file, p, q):
    """The posed vertices as numbers x + iy, rows x columns."""
    family, size, columns, rows, count, members, width, height = struct.unpack_from("<8I", file, 8)
    P, Q = np.zeros((2, count, 1, 1), complex)
    for column, handle, place, share in struct.iter_unpack("<3If", file[64 : 64 + 16 * members]):
        P[column] += share * complex(*np.atleast_2d(p[handle])[place])
        Q[column] += share * complex(*np.atleast_2d(q[handle])[place])
    v = np.linspace(0, width, columns) + 1j * np.linspace(0, height, rows)[:, None]
    numbers = np.frombuffer(file, f"<f{size}", offset=64 + 16 * members)
    if family == 3:  # beier_neely: three numbers for each segment
        a, b, c = numbers.reshape(count // 2, 3, rows, columns).swapaxes(0, 1)
        d, posed = P[1::2] - P[::2], Q[1::2] - Q[::2]
        turned = 1j * posed / abs(posed) - 1j * d / abs(d)
        return v + (a * (Q - P)[::2] + b * (posed - d) + c * turned).sum(0)
    table = numbers.reshape(count, family + 1, rows, columns)
    B = table[:, 0] + (1j * table[:, 1] if family else 0)
    if family < 2:  # affine, similarity
        return v + (B * (Q - P)).sum(0)
    e = v - (table[:, 2] * P).sum(0)
    F = e + (B * (Q - P)).sum(0)
    F = np.where(abs(F) > 1e-5 * abs(e), F, e)  # without a direction, nothing turns
    return (table[:, 2] * Q).sum(0) + abs(e) * F / np.maximum(abs(F), 1e-30)


server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content
rest = {"p": [[168, 112], [316, 136], [[60, 250], [390, 260]]], "grid": {"columns": 50, "rows": 50}}
created = server.post("/sessions", files={"image": image}, data={"warp": json.dumps(rest)})
if created.is_error:
    raise SystemExit(created.json()["detail"])
session = created.json()["id"]
file = server.get(f"/sessions/{session}/plan").raise_for_status().content
print(len(file), "bytes, once for all poses")

q = [[150, 104], [338, 126], [[60, 270], [390, 240]]]
mesh = server.post(f"/sessions/{session}/mesh", json={"q": q}).raise_for_status().json()
difference = pose(file, rest["p"], q).ravel() - [complex(*vertex) for vertex in mesh["vertices"]]
print("px from the mesh of the server:", max(abs(difference)))
server.delete(f"/sessions/{session}")
