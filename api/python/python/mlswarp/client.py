"""The service behind the names of the package: `Client` with threads, `AsyncClient` without.

Needs the extra ``client``: ``pip install 'mlswarp[client]'``. Requests are repeated after broken
connections and 408, 429, 502, 503 and 504, which is safe: every request here may be repeated. 409
means that a newer pose was drawn, and is raised.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar

import httpx2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _calls
from ._async_client import AsyncBatch, AsyncClient, AsyncSession
from ._calls import Call, Rendered, delay_before, failure_of, is_gone, problem_of
from ._drag import AsyncDrag, Drag, Frame
from ._files import File
from ._pose import Report
from ._settings import Opened, Settings
from ._values import Coordinates, Handles
from .errors import MlswarpError

__all__ = [
    "AsyncBatch",
    "AsyncClient",
    "AsyncDrag",
    "AsyncSession",
    "Batch",
    "Client",
    "Drag",
    "Frame",
    "Rendered",
    "Session",
]

T = TypeVar("T")


class Client:
    """A server, for programs with threads. The same names and results as in the process.

    `url`: of the server; otherwise ``MLSWARP_URL``, or this machine. `api_key`: otherwise
    ``MLSWARP_KEY``. `timeout`: seconds without a byte. `http_client`: your own `httpx2.Client`.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        api_key: str | None = None,
        timeout: float = 60.0,
        max_retries: int = 2,
        http_client: httpx2.Client | None = None,
    ) -> None:
        self._settings = Settings(url, api_key, timeout, max_retries)
        self._owns = http_client is None
        self._http = http_client or httpx2.Client()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        if self._owns:
            self._http.close()

    def with_options(
        self, *, timeout: float | None = None, max_retries: int | None = None
    ) -> Client:
        """The same connections with other patience."""
        other = Client.__new__(Client)
        other._settings = Settings.__new__(Settings)
        other._settings.__dict__.update(self._settings.__dict__)
        if timeout is not None:
            other._settings.timeout = timeout
        if max_retries is not None:
            other._settings.max_retries = max_retries
        other._http, other._owns = self._http, False
        return other

    def warp(
        self,
        image: File,
        warp: Mapping[str, Any] | str | bytes,
        *,
        region: File | None = None,
    ) -> Rendered:
        """``POST /warp``: the bytes of `mlswarp.warp_file`."""
        return self._run(_calls.warp_once(image, warp, region))

    def blend(
        self,
        images: Sequence[File],
        blend: Mapping[str, Any],
        *,
        landmarks: Sequence[File] = (),
        accept: str | None = None,
    ) -> Rendered:
        """``POST /blend``: several images in one. `blend`: the object of the request, whose images
        are numbers of `images` or ids of sessions. `landmarks`: a file for each image, in place of
        handles in `blend`. `accept`: ``image/apng``, ``image/gif`` or ``application/zip`` for
        several frames."""
        return self._run(_calls.blend(images, blend, landmarks, accept))

    def open(
        self,
        image: File,
        p: Handles | None = None,
        *,
        reopen: bool = False,
        region: File | None = None,
        **rest: Any,
    ) -> Session:
        """A session with an image and handles at rest, for many poses: use it in a `with` block.
        `rest`: everything else of a warp object. `reopen`: a session that the server has lost is
        opened again from the image that is kept here (without its layers)."""
        opened = Opened(image, p, rest, region)
        return Session(self, opened, self._run(opened.call()), reopen)

    def _run(self, call: Call[T]) -> T:
        return call.read(self._send(call, stream=False))

    def _send(self, call: Call[Any], *, stream: bool) -> httpx2.Response:
        for attempt in range(self._settings.max_retries + 1):
            response: httpx2.Response | None = None
            try:
                request = self._http.build_request(**self._settings.request(call))
                response = self._http.send(request, stream=stream)
                if response.is_success:
                    return response
                if stream:
                    response.read()
                failure: MlswarpError = problem_of(response)
            except httpx2.TransportError as error:
                failure = failure_of(error, self._settings.url)
            delay = delay_before(attempt, response)
            if delay is None or attempt == self._settings.max_retries:
                raise failure
            time.sleep(delay)
        raise AssertionError("the last attempt returns or raises")


class Session:
    """An image with handles at rest on a server. Made by `Client.open`."""

    def __init__(
        self, client: Client, opened: Opened, session: dict[str, Any], reopen: bool
    ) -> None:
        self._client = client
        self._opened = opened
        self._session = session
        self._reopen = reopen

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # A session that is not deleted expires.
        with suppress(MlswarpError):
            self.delete()

    @property
    def id(self) -> str:
        """Its name in paths."""
        return self._opened.id

    @property
    def info(self) -> Mapping[str, Any]:
        """What the server says of it: handles, size, effective parameters."""
        return self._session

    def delete(self) -> None:
        """Ends the session."""
        self._client._run(_calls.delete_session(self.id))

    def warp(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        layer: str | None = None,
        output: Mapping[str, Any] | None = None,
    ) -> Rendered:
        """The image, or a layer, in a pose."""
        return self._run(_calls.warp(self.id, q, strength, layer, output))

    def points(
        self,
        xy: Coordinates,
        *,
        q: Handles | None = None,
        strength: float | None = None,
        inverse: bool = False,
    ) -> NDArray[np.float64]:
        """As `Pose.points`."""
        return self._run(_calls.points(self.id, xy, q, strength, inverse))

    def boxes(
        self,
        ltrb: ArrayLike,
        *,
        q: Handles | None = None,
        strength: float | None = None,
        inverse: bool = False,
    ) -> NDArray[np.float64]:
        """As `Pose.boxes`."""
        return self._run(_calls.boxes(self.id, ltrb, q, strength, inverse))

    def map(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        direction: Literal["inverse", "forward"] = "inverse",
    ) -> NDArray[np.float32]:
        """As `Pose.map`."""
        return self._run(_calls.position_map(self.id, q, strength, direction))

    def report(self, q: Handles | None = None, *, strength: float | None = None) -> Report:
        """As `Pose.report`."""
        return self._run(_calls.report(self.id, q, strength))

    def put_layer(
        self, name: str, file: File, *, kind: Literal["image", "labels"] = "image"
    ) -> None:
        """Stores a further image of the session, which follows the warp."""
        self._session = self._run(_calls.put_layer(self.id, name, file, kind))

    def batch(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        accept: Literal["application/zip", "image/apng", "image/gif"] = "application/zip",
        **more: Any,
    ) -> AbstractContextManager[Batch]:
        """Many poses in one file, which is read while it is drawn: use it in a `with` block.
        `more`: `frames`, `steps` or `jitter`, and everything else of the request."""
        return Batch(self, _calls.batch(self.id, q, strength, accept, more))

    def drag(self, **options: str | int) -> Drag:
        """A drag over a WebSocket, for a `with` block. `options`: `frames`, `width`, `window`."""
        client = self._client
        given = {name: str(value) for name, value in options.items()}
        address = f"{client._settings.url}/sessions/{self.id}/drag"

        async def reopen() -> bool:
            return await asyncio.to_thread(self._open_again)

        settings = client._settings
        return Drag(lambda: AsyncDrag(address, settings.headers, given, reopen, settings.timeout))

    def _open_again(self) -> bool:
        if self._reopen:
            self._session = self._client._run(self._opened.call())
        return self._reopen

    def _run(self, call: Call[T]) -> T:
        return call.read(self._send(call, stream=False))

    def _send(self, call: Call[Any], *, stream: bool) -> httpx2.Response:
        try:
            return self._client._send(call, stream=stream)
        except MlswarpError as error:
            if not is_gone(error) or not self._open_again():
                raise
        return self._client._send(call, stream=stream)


class Batch:
    """The bytes of a batch."""

    def __init__(self, session: Session, call: Call[None]) -> None:
        self._session = session
        self._call = call
        self._response: httpx2.Response | None = None

    def __enter__(self) -> Batch:
        self._response = self._session._send(self._call, stream=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._response is not None:
            self._response.close()

    def __iter__(self) -> Iterator[bytes]:
        if self._response is None:
            raise RuntimeError("use the batch in a `with` block")
        try:
            yield from self._response.iter_bytes()
        except httpx2.TransportError as error:
            raise failure_of(error, "the batch") from error

    def to_file(self, path: str | PathLike[str]) -> None:
        """Writes the file as it comes."""
        with Path(path).open("wb") as out:
            for piece in self:
                out.write(piece)
