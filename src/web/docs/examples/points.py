import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
answer = server.post(
    "/points",
    json={
        "extent": [451, 300],
        "p": [[168, 112], [316, 136], [262, 240]],
        "q": [[150, 104], [338, 126], [262, 262]],
        "points": [[168, 112], [240, 180]],
    },
)
if answer.is_error:
    raise SystemExit(answer.json()["detail"])
print(answer.json()["points"])
