"""What the clients know of a server, and of a session that they have opened."""

from __future__ import annotations

import os
import uuid
from collections.abc import Mapping
from typing import Any

import httpx2

from . import _calls
from ._calls import Call
from ._files import File, _read
from ._values import Handles, json_handles, to_json

_DEFAULT_URL = "http://127.0.0.1:8080"
_CONNECT_SECONDS = 5.0


class Settings:
    """What both clients know."""

    def __init__(
        self, url: str | None, api_key: str | None, timeout: float, max_retries: int
    ) -> None:
        self.url = (url or os.environ.get("MLSWARP_URL") or _DEFAULT_URL).rstrip("/")
        key = api_key or os.environ.get("MLSWARP_KEY")
        self.headers = {"Authorization": f"Bearer {key}"} if key else {}
        self.timeout = timeout
        self.max_retries = max_retries

    def http(self) -> dict[str, Any]:
        timeout = httpx2.Timeout(self.timeout, connect=min(_CONNECT_SECONDS, self.timeout))
        return {"timeout": timeout}

    def request(self, call: Call[Any]) -> dict[str, Any]:
        options = {**call.options(), **self.http()}
        options["headers"] = {**self.headers, **options["headers"]}
        return {"method": call.method, "url": f"{self.url}/{call.path}", **options}


class Opened:
    """What is needed to open a session, once more if it has to be."""

    def __init__(
        self, image: File, p: Handles | None, rest: Mapping[str, Any], region: File | None
    ) -> None:
        self.id: str = str(uuid.uuid4())
        self.image: bytes = _read(image)
        self.region: bytes | None = None if region is None else _read(region)
        handles = {} if p is None else {"p": json_handles(p, "p")}
        self.warp: bytes = to_json({**handles, **rest})

    def call(self) -> Call[dict[str, Any]]:
        return _calls.put_session(self.id, self.image, self.warp, self.region)
