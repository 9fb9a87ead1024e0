"""The client for programs with an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar

import httpx2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _calls
from ._calls import Call, Rendered, delay_before, failure_of, is_gone, problem_of
from ._drag import AsyncDrag
from ._files import File
from ._pose import Report
from ._settings import Opened, Settings
from ._values import Coordinates, Handles
from .errors import MlswarpError

T = TypeVar("T")


class AsyncClient:
    """A server, for programs with an event loop: `Client` with `await` and `async with`."""

    def __init__(
        self,
        url: str | None = None,
        *,
        api_key: str | None = None,
        timeout: float = 60.0,
        max_retries: int = 2,
        http_client: httpx2.AsyncClient | None = None,
    ) -> None:
        self._settings = Settings(url, api_key, timeout, max_retries)
        self._owns = http_client is None
        self._http = http_client or httpx2.AsyncClient()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Closes the connections."""
        if self._owns:
            await self._http.aclose()

    async def warp(
        self,
        image: File,
        warp: Mapping[str, Any] | str | bytes,
        *,
        region: File | None = None,
    ) -> Rendered:
        """As `Client.warp`."""
        return await self._run(_calls.warp_once(image, warp, region))

    async def blend(
        self,
        images: Sequence[File],
        blend: Mapping[str, Any],
        *,
        landmarks: Sequence[File] = (),
        accept: str | None = None,
    ) -> Rendered:
        """As `Client.blend`."""
        return await self._run(_calls.blend(images, blend, landmarks, accept))

    async def open(
        self,
        image: File,
        p: Handles | None = None,
        *,
        reopen: bool = False,
        region: File | None = None,
        **rest: Any,
    ) -> AsyncSession:
        """As `Client.open`, for an `async with` block."""
        opened = Opened(image, p, rest, region)
        return AsyncSession(self, opened, await self._run(opened.call()), reopen)

    async def _run(self, call: Call[T]) -> T:
        return call.read(await self._send(call, stream=False))

    async def _send(self, call: Call[Any], *, stream: bool) -> httpx2.Response:
        for attempt in range(self._settings.max_retries + 1):
            response: httpx2.Response | None = None
            try:
                request = self._http.build_request(**self._settings.request(call))
                response = await self._http.send(request, stream=stream)
                if response.is_success:
                    return response
                if stream:
                    await response.aread()
                failure: MlswarpError = problem_of(response)
            except httpx2.TransportError as error:
                failure = failure_of(error, self._settings.url)
            delay = delay_before(attempt, response)
            if delay is None or attempt == self._settings.max_retries:
                raise failure
            await asyncio.sleep(delay)
        raise AssertionError("the last attempt returns or raises")


class AsyncSession:
    """`Session` with `await`. Made by `AsyncClient.open`."""

    def __init__(
        self, client: AsyncClient, opened: Opened, session: dict[str, Any], reopen: bool
    ) -> None:
        self._client = client
        self._opened = opened
        self._session = session
        self._reopen = reopen

    async def __aenter__(self) -> AsyncSession:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(MlswarpError):
            await self.delete()

    @property
    def id(self) -> str:
        """Its name in paths."""
        return self._opened.id

    @property
    def info(self) -> Mapping[str, Any]:
        """What the server says of it: handles, size, effective parameters."""
        return self._session

    async def delete(self) -> None:
        """Ends the session."""
        await self._client._run(_calls.delete_session(self.id))

    async def warp(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        layer: str | None = None,
        output: Mapping[str, Any] | None = None,
    ) -> Rendered:
        """As `Session.warp`."""
        return await self._run(_calls.warp(self.id, q, strength, layer, output))

    async def points(
        self,
        xy: Coordinates,
        *,
        q: Handles | None = None,
        strength: float | None = None,
        inverse: bool = False,
    ) -> NDArray[np.float64]:
        """As `Pose.points`."""
        return await self._run(_calls.points(self.id, xy, q, strength, inverse))

    async def boxes(
        self,
        ltrb: ArrayLike,
        *,
        q: Handles | None = None,
        strength: float | None = None,
        inverse: bool = False,
    ) -> NDArray[np.float64]:
        """As `Pose.boxes`."""
        return await self._run(_calls.boxes(self.id, ltrb, q, strength, inverse))

    async def map(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        direction: Literal["inverse", "forward"] = "inverse",
    ) -> NDArray[np.float32]:
        """As `Pose.map`."""
        return await self._run(_calls.position_map(self.id, q, strength, direction))

    async def report(self, q: Handles | None = None, *, strength: float | None = None) -> Report:
        """As `Pose.report`."""
        return await self._run(_calls.report(self.id, q, strength))

    async def put_layer(
        self, name: str, file: File, *, kind: Literal["image", "labels"] = "image"
    ) -> None:
        """As `Session.put_layer`."""
        self._session = await self._run(_calls.put_layer(self.id, name, file, kind))

    def batch(
        self,
        q: Handles | None = None,
        *,
        strength: float | None = None,
        accept: Literal["application/zip", "image/apng", "image/gif"] = "application/zip",
        **more: Any,
    ) -> AbstractAsyncContextManager[AsyncBatch]:
        """As `Session.batch`, for an `async with` block."""
        return AsyncBatch(self, _calls.batch(self.id, q, strength, accept, more))

    def drag(self, **options: str | int) -> AsyncDrag:
        """As `Session.drag`, for `async with` and `async for`."""
        settings = self._client._settings
        given = {name: str(value) for name, value in options.items()}
        address = f"{settings.url}/sessions/{self.id}/drag"
        return AsyncDrag(address, settings.headers, given, self._open_again, settings.timeout)

    async def _open_again(self) -> bool:
        if self._reopen:
            self._session = await self._client._run(self._opened.call())
        return self._reopen

    async def _run(self, call: Call[T]) -> T:
        return call.read(await self._send(call, stream=False))

    async def _send(self, call: Call[Any], *, stream: bool) -> httpx2.Response:
        try:
            return await self._client._send(call, stream=stream)
        except MlswarpError as error:
            if not is_gone(error) or not await self._open_again():
                raise
        return await self._client._send(call, stream=stream)


class AsyncBatch:
    """The bytes of a batch."""

    def __init__(self, session: AsyncSession, call: Call[None]) -> None:
        self._session = session
        self._call = call
        self._response: httpx2.Response | None = None

    async def __aenter__(self) -> AsyncBatch:
        self._response = await self._session._send(self._call, stream=True)
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._response is not None:
            await self._response.aclose()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        if self._response is None:
            raise RuntimeError("use the batch in an `async with` block")
        try:
            async for piece in self._response.aiter_bytes():
                yield piece
        except httpx2.TransportError as error:
            raise failure_of(error, "the batch") from error

    async def to_file(self, path: str | PathLike[str]) -> None:
        """Writes the file as it comes."""
        with Path(path).open("wb") as out:
            async for piece in self:
                out.write(piece)
