import json

import httpx

server = httpx.Client(base_url="http://127.0.0.1:8080")
image = server.get("/page/cat.jpg").raise_for_status().content

warp = {"p": [[168, 112]], "q": [[150, 104]], "metod": "rigid"}
answer = server.post("/warp", files={"image": image}, data={"warp": json.dumps(warp)})
if answer.is_error:
    problem = answer.json()
    print(answer.status_code, problem["code"], problem.get("pointer"), problem["detail"])
