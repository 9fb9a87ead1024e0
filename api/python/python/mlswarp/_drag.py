"""A drag over a WebSocket: poses in, frames out. The newest pose wins on both sides."""

from __future__ import annotations

import asyncio
import random
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any, TypeVar
from urllib.parse import urlencode

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from ._calls import is_gone, of_message, pose_of
from ._values import Handles, to_json
from .errors import AuthenticationError, ConnectionFailed, MlswarpError, of_answer

T = TypeVar("T")

_SEQ_BYTES = 8
_FIRST_DELAY, _MOST_DELAY = 0.2, 5.0
# Closed by the server for good: the end of the session, and what the client must not do.
_NORMAL, _POLICY, _TOO_LARGE = 1000, 1008, 1009


@dataclass(frozen=True)
class Frame:
    """One frame of a drag."""

    seq: int
    """The number of the pose that it shows."""
    full: bool
    """Whether it is no preview: what `session.warp` would give."""
    content: bytes
    """An image file, or the vertices of a mesh."""
    report: Mapping[str, Any]
    """Size, folds, residual, warnings and times."""


class AsyncDrag:
    """A drag for `async with` and `async for`: to advance acknowledges the frame before."""

    def __init__(
        self,
        address: str,
        headers: Mapping[str, str],
        options: Mapping[str, str],
        reopen: Callable[[], Awaitable[bool]],
        patience: float,
    ) -> None:
        self._url = f"{address.replace('http', 'ws', 1)}?{urlencode({**options, 'report': 'true'})}"
        self._headers = dict(headers)
        self._reopen = reopen
        self._patience = patience
        self._seq = -1
        self._newest: bytes | None = None
        self._unsent = asyncio.Event()
        self._frames: asyncio.Queue[Frame | MlswarpError | None] = asyncio.Queue()
        self._socket: ClientConnection | None = None
        self._shown: int | None = None
        self._running: asyncio.Task[None] | None = None

    def pose(self, q: Handles | None = None, *, strength: float | None = None) -> int:
        """Asks for a frame of a pose, and returns its number. Never waits: a newer pose takes the
        place of one that was not sent yet."""
        given = pose_of(q, strength)
        self._seq += 1
        self._newest = to_json({"seq": self._seq, **given})
        self._unsent.set()
        return self._seq

    async def __aenter__(self) -> AsyncDrag:
        self._running = asyncio.create_task(self._run())
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Ends the drag."""
        if self._running is not None:
            self._running.cancel()
            with suppress(asyncio.CancelledError):
                await self._running

    def __aiter__(self) -> AsyncIterator[Frame]:
        return self

    async def __anext__(self) -> Frame:
        if self._shown is not None:
            await self._acknowledge(self._shown)
            self._shown = None
        frame = await self._frames.get()
        if frame is None:
            self._frames.put_nowait(None)
            raise StopAsyncIteration
        if isinstance(frame, MlswarpError):
            raise frame
        self._shown = frame.seq
        return frame

    async def _acknowledge(self, seq: int) -> None:
        if self._socket is not None:
            # A socket that is closed is opened again, and has other frames.
            with suppress(ConnectionClosed):
                await self._socket.send(to_json({"ack": seq}).decode())

    async def _run(self) -> None:
        delay = _FIRST_DELAY
        try:
            while True:
                try:
                    async with connect(
                        self._url,
                        additional_headers=self._headers,
                        max_size=None,
                        open_timeout=self._patience,
                        close_timeout=1,
                    ) as socket:
                        self._socket, delay = socket, _FIRST_DELAY
                        # A new socket knows no pose.
                        if self._newest is not None:
                            self._unsent.set()
                        await self._serve(socket)
                except InvalidStatus as refused:
                    if not await self._may_retry(refused):
                        return
                except (OSError, InvalidHandshake, ConnectionClosed):
                    pass
                finally:
                    self._socket = None
                await asyncio.sleep(delay * random.uniform(0.5, 1))
                delay = min(2 * delay, _MOST_DELAY)
        except MlswarpError as error:
            self._frames.put_nowait(error)
        finally:
            self._frames.put_nowait(None)

    async def _may_retry(self, refused: InvalidStatus) -> bool:
        status, body = refused.response.status_code, refused.response.body or b""
        if status in (408, 429, 502, 503, 504):
            return True
        try:
            error = of_answer(status, of_message(bytes(body)))
        except (ValueError, KeyError):
            error = ConnectionFailed(f"the server answers {status}", code="unknown")
        if is_gone(error) and await self._reopen():
            return True
        raise error

    async def _serve(self, socket: ClientConnection) -> None:
        """Sends and receives until the socket closes."""
        sending = asyncio.create_task(self._send(socket))
        try:
            await self._receive(socket)
        except ConnectionClosed as closed:
            code = closed.rcvd.code if closed.rcvd else None
            reason = closed.rcvd.reason if closed.rcvd else ""
            if code == _POLICY and reason == "token_expired":
                raise AuthenticationError("the token has expired", code=reason) from None
            if code in (_POLICY, _TOO_LARGE):
                raise ConnectionFailed(
                    f"the server ends the drag: {reason}", code="closed"
                ) from None
            if code == _NORMAL and not await self._reopen():
                raise ConnectionFailed("the session has ended", code="closed") from None
            raise
        finally:
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _send(self, socket: ClientConnection) -> None:
        while True:
            await self._unsent.wait()
            self._unsent.clear()
            if self._newest is not None:
                await socket.send(self._newest.decode())

    async def _receive(self, socket: ClientConnection) -> None:
        report: Mapping[str, Any] = {}
        while True:
            message = await socket.recv()
            if isinstance(message, str):
                report = of_message(message)
                if "code" in report:
                    self._frames.put_nowait(of_answer(int(report.get("status", 422)), dict(report)))
                continue
            seq = int.from_bytes(message[:_SEQ_BYTES], "little")
            frame = Frame(seq, bool(report.get("full")), message[_SEQ_BYTES:], report)
            self._frames.put_nowait(frame)


class Drag:
    """A drag for `with` and `for`, on a thread of its own."""

    def __init__(self, make: Callable[[], AsyncDrag]) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="mlswarp-drag", daemon=True
        )
        self._make = make
        self._drag: AsyncDrag | None = None

    def __enter__(self) -> Drag:
        self._thread.start()

        async def begin() -> AsyncDrag:
            return await self._make().__aenter__()

        self._drag = self._wait(begin())
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends the drag."""
        if self._thread.is_alive():
            self._wait(self._begun().aclose())
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()

    def pose(self, q: Handles | None = None, *, strength: float | None = None) -> int:
        """Asks for a frame of a pose, and returns its number: a newer pose takes the place of one
        that was not sent yet."""

        async def ask() -> int:
            return self._begun().pose(q, strength=strength)

        return self._wait(ask())

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        async def advance() -> Frame | None:
            try:
                return await self._begun().__anext__()
            except StopAsyncIteration:
                return None

        frame = self._wait(advance())
        if frame is None:
            raise StopIteration
        return frame

    def _begun(self) -> AsyncDrag:
        if self._drag is None:
            raise RuntimeError("use the drag in a `with` block")
        return self._drag

    def _wait(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()
