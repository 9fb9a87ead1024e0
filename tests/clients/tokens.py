"""Session tokens by PyJWT, without a request to the server: it accepts them, and refuses what PyJWT
makes otherwise.

python tokens.py SERVER KEY SECRET
"""

import base64
import hashlib
import hmac
import json
import sys
import time
import urllib.error
import urllib.request
import uuid

import jwt

server, key, secret = sys.argv[1:]


def text(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def claims(session: str, **more) -> dict:
    """As deploy/README.md describes them."""
    owner = hashlib.sha256(b"mlswarp owner\0ann").digest()[:16]
    signed = b"mlswarp key\0" + hashlib.sha256(key.encode()).digest()
    mark = hmac.digest(secret.encode(), signed, "sha256")[:8]
    now = int(time.time())
    return {
        "aud": "mlswarp",
        "own": text(owner),
        "key": text(mark),
        "sid": session,
        "ops": ["read", "upload"],
        "iat": now,
        "exp": now + 600,
        "jti": str(uuid.uuid4()),
        **more,
    }


def token(session: str, algorithm="HS256", header=None, **more) -> str:
    header = header or {"kid": "k1", "typ": "mlswarp+jwt"}
    return jwt.encode(claims(session, **more), secret, algorithm, headers=header)


def read(session: str, bearer: str) -> tuple[int, str]:
    """The status and the code: 404 says that the token was accepted, before the session was."""
    request = urllib.request.Request(
        f"{server}/sessions/{session}", headers={"Authorization": f"Bearer {bearer}"}
    )
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.status, ""
    except urllib.error.HTTPError as refused:
        return refused.code, json.load(refused)["code"]


session = str(uuid.uuid4())
assert read(session, token(session)) == (404, "no_such_session")
late = int(time.time())
assert read(session, token(session, exp=late - 90, iat=late - 690)) == (401, "token_expired")
for wrong in (
    token(session, algorithm="HS512"),
    token(session, header={"kid": "k1"}),
    token(session, header={"kid": "k2", "typ": "mlswarp+jwt"}),
    token(session, exp=float(late + 600)),
    token(session, nbf=late),
):
    assert read(session, wrong) == (401, "unauthorized"), wrong
assert read(session, token(str(uuid.uuid4()))) == (403, "forbidden")
# And what the server makes, PyJWT reads.
request = urllib.request.Request(
    f"{server}/sessions/{session}/tokens",
    json.dumps({"ops": ["upload"], "ttl": 60}).encode(),
    {"Authorization": f"Bearer {key}", "Content-Type": "application/json"},
)
minted = json.load(urllib.request.urlopen(request))["token"]
made = jwt.decode(minted, secret, algorithms=["HS256"], audience="mlswarp")
assert made["sid"] == session and made["exp"] - made["iat"] == 60 and made["ops"] == ["upload"]
assert made["own"] == claims(session)["own"] and made["key"] == claims(session)["key"]
print("tokens: PyJWT and the server read each other's")
