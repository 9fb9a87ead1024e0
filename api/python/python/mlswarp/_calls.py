"""Requests to a server and what they answer, for the client with threads and for that without."""

from __future__ import annotations

import io
import json
import random
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Generic, TypeVar

import httpx2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._files import File, _read
from ._pose import Report, report_of
from ._values import Coordinates, Handles, json_handles, positions, to_json
from .errors import (
    ApiError,
    ConnectionFailed,
    MlswarpError,
    RequestTimeout,
    of_answer,
)

T = TypeVar("T")
Response = httpx2.Response

# 409 is an answer: a newer pose has been drawn.
_REPEATED = frozenset({408, 429, 502, 503, 504})
_FIRST_DELAY, _MOST_DELAY, _MOST_RETRY_AFTER = 0.5, 8.0, 120.0
_PROBLEM_BYTES = 300


@dataclass(frozen=True)
class Rendered:
    """An image that a server has drawn."""

    content: bytes
    """The file."""
    folds: int
    residual: float | None
    warnings: tuple[str, ...]
    etag: str | None
    request_id: str | None
    timing: Mapping[str, float]
    """Milliseconds of each stage."""
    method: str | None
    """What ``auto`` has chosen."""
    canvas: tuple[int, int, int, int] | None
    """The part of the posed plane that is shown, if it is not that of the image."""

    def save(self, path: str | PathLike[str]) -> None:
        """Writes the file."""
        Path(path).write_bytes(self.content)

    def image(self) -> Any:
        """An image of PIL, which has to be installed."""
        from PIL import Image

        return Image.open(io.BytesIO(self.content))

    def array(self) -> NDArray[Any]:
        """The pixels, by PIL."""
        return np.asarray(self.image())


@dataclass(frozen=True)
class Call(Generic[T]):
    """A request that may be repeated, and how its answer is read."""

    method: str
    path: str
    read: Callable[[Response], T]
    json: bytes | None = None
    content: bytes | None = None
    files: Sequence[tuple[str, Any]] | None = None
    params: Mapping[str, str] = field(default_factory=dict)
    accept: str | None = None

    def options(self) -> dict[str, Any]:
        headers = {} if self.accept is None else {"Accept": self.accept}
        options: dict[str, Any] = {"headers": headers, "params": dict(self.params)}
        if self.json is not None:
            headers["Content-Type"] = "application/json"
            options["content"] = self.json
        elif self.content is not None:
            headers["Content-Type"] = "application/octet-stream"
            options["content"] = self.content
        elif self.files is not None:
            options["files"] = list(self.files)
        return options


def problem_of(response: Response) -> MlswarpError:
    """The exception of an answer that failed, whose body has been read."""
    try:
        problem = response.json()
        error = of_answer(response.status_code, problem)
    except (ValueError, TypeError, KeyError):
        # Something else is there, such as a proxy.
        detail = f"the server answers {response.status_code}: {response.text[:_PROBLEM_BYTES]!r}"
        error = of_answer(response.status_code, {"code": "unknown", "detail": detail})
    if error.request_id is None:
        error.request_id = response.headers.get("x-request-id")
    return error


def failure_of(error: httpx2.TransportError, address: str) -> ConnectionFailed:
    """The exception of a request without an answer."""
    if isinstance(error, httpx2.TimeoutException):
        return RequestTimeout(f"{address} does not answer in time", code="timeout")
    return ConnectionFailed(f"{address} cannot be reached: {error}", code="unavailable")


def delay_before(attempt: int, response: Response | None) -> float | None:
    """Seconds before a request is repeated; `None` if it is not. `response`: what was answered."""
    if response is not None and response.status_code not in _REPEATED:
        return None
    delay: float = min(_FIRST_DELAY * 2.0**attempt, _MOST_DELAY) * random.uniform(0.5, 1)
    if response is not None:
        asked = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*", response.headers.get("retry-after", ""))
        if asked:
            seconds = float(asked[1])
            return None if seconds > _MOST_RETRY_AFTER else max(delay, seconds)
    return delay


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _rendered(response: Response) -> Rendered:
    headers = response.headers
    warnings = (code.strip() for code in headers.get("warp-warning", "").split(","))
    stages = re.findall(r"([\w-]+);dur=([\d.]+)", headers.get("server-timing", ""))
    canvas = headers.get("warp-canvas")
    x, y, width, height = (0, 0, 0, 0) if canvas is None else map(int, canvas.split(","))
    return Rendered(
        content=response.content,
        folds=int(headers.get("warp-folds", 0)),
        residual=_number(headers.get("warp-residual")),
        warnings=tuple(code for code in warnings if code),
        etag=headers.get("etag"),
        request_id=headers.get("x-request-id"),
        timing={name: float(duration) for name, duration in stages},
        method=headers.get("warp-method"),
        canvas=None if canvas is None else (x, y, width, height),
    )


def _json(response: Response) -> dict[str, Any]:
    answer: dict[str, Any] = response.json()
    return answer


def _nothing(_: Response) -> None:
    return None


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def pose_of(q: Handles | None, strength: float | None) -> dict[str, Any]:
    """A pose; that of the session where nothing is given."""
    return _given(q=None if q is None else json_handles(q, "q"), strength=strength)


def _upload(image: bytes, warp: bytes, region: bytes | None) -> list[tuple[str, Any]]:
    parts: list[tuple[str, Any]] = [("image", ("image", image)), _object("warp", warp)]
    return parts if region is None else [*parts, ("region", ("region", region))]


def _object(name: str, json: bytes) -> tuple[str, Any]:
    return name, (None, json, "application/json")


def warp_object(warp: Mapping[str, Any] | str | bytes) -> bytes:
    if isinstance(warp, bytes):
        return warp
    return warp.encode() if isinstance(warp, str) else to_json(_with_handles(warp))


def _with_handles(warp: Mapping[str, Any]) -> dict[str, Any]:
    handles = {name: json_handles(warp[name], name) for name in ("p", "q") if name in warp}
    return {**warp, **handles}


def warp_once(
    image: File, warp: Mapping[str, Any] | str | bytes, region: File | None
) -> Call[Rendered]:
    mask = None if region is None else _read(region)
    files = _upload(_read(image), warp_object(warp), mask)
    return Call("POST", "warp", _rendered, files=files)


def blend(
    images: Sequence[File],
    blend: Mapping[str, Any],
    landmarks: Sequence[File],
    accept: str | None,
) -> Call[Rendered]:
    files = [
        *(("image", (f"image-{k}", _read(file))) for k, file in enumerate(images)),
        *(("landmarks", (f"landmarks-{k}", _read(file))) for k, file in enumerate(landmarks)),
        _object("blend", to_json(blend)),
    ]
    return Call("POST", "blend", _rendered, files=files, accept=accept)


def put_session(
    session: str, image: bytes, warp: bytes, region: bytes | None
) -> Call[dict[str, Any]]:
    return Call("PUT", f"sessions/{session}", _json, files=_upload(image, warp, region))


def delete_session(session: str) -> Call[None]:
    return Call("DELETE", f"sessions/{session}", _nothing)


def warp(
    session: str, q: Handles | None, strength: float | None, layer: str | None, output: Any
) -> Call[Rendered]:
    body = {**pose_of(q, strength), **_given(layer=layer, output=output)}
    return Call("POST", f"sessions/{session}/warp", _rendered, json=to_json(body))


def _annotations(
    session: str, q: Handles | None, strength: float | None, request: Mapping[str, Any]
) -> Callable[[Callable[[dict[str, Any]], T]], Call[T]]:
    body = to_json({**pose_of(q, strength), **request})
    path = f"sessions/{session}/points"
    return lambda read: Call("POST", path, lambda response: read(_json(response)), json=body)


def _rows(found: list[Any], columns: int) -> NDArray[np.float64]:
    rows = [[np.nan] * columns if row is None else row for row in found]
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def points(
    session: str, xy: Coordinates, q: Handles | None, strength: float | None, inverse: bool
) -> Call[NDArray[np.float64]]:
    rows = [None if np.isnan(row).any() else row.tolist() for row in positions(xy)]
    request = _annotations(session, q, strength, {"points": rows, "inverse": inverse})
    return request(lambda answer: _rows(answer["points"], 2))


def boxes(
    session: str, ltrb: ArrayLike, q: Handles | None, strength: float | None, inverse: bool
) -> Call[NDArray[np.float64]]:
    given = np.asarray(ltrb, dtype=np.float64).reshape(-1, 4)
    rows = [None if np.isnan(row).any() else row.tolist() for row in given]
    request = _annotations(session, q, strength, {"boxes": rows, "inverse": inverse})
    return request(lambda answer: _rows(answer["boxes"], 4))


def position_map(
    session: str, q: Handles | None, strength: float | None, direction: str
) -> Call[NDArray[np.float32]]:
    def read(response: Response) -> NDArray[np.float32]:
        return np.asarray(np.load(io.BytesIO(response.content), allow_pickle=False), np.float32)

    body = to_json({**pose_of(q, strength), "direction": direction})
    path, accept = f"sessions/{session}/map", "application/x-npy"
    return Call("POST", path, read, json=body, accept=accept)


def report(session: str, q: Handles | None, strength: float | None) -> Call[Report]:
    def read(response: Response) -> Report:
        return report_of(_json(response))

    return Call("POST", f"sessions/{session}/report", read, json=to_json(pose_of(q, strength)))


def put_layer(session: str, name: str, file: File, kind: str) -> Call[dict[str, Any]]:
    path, params = f"sessions/{session}/layers/{name}", {"kind": kind}
    return Call("PUT", path, _json, content=_read(file), params=params)


def batch(
    session: str, q: Handles | None, strength: float | None, accept: str, more: Mapping[str, Any]
) -> Call[None]:
    body = {**pose_of(q, strength), **more}
    path = f"sessions/{session}/batch"
    return Call("POST", path, _nothing, json=to_json(body), accept=accept)


def is_gone(error: MlswarpError) -> bool:
    """Whether the session has to be opened again."""
    return isinstance(error, ApiError) and error.code in ("no_such_session", "session_expired")


def of_message(text: str | bytes) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(text)
    return message
