"""What can go wrong, by what the caller can change.

Every error has the service's ``code`` (``api/problems.md`` describes each), a sentence, and the
place in the warp object: the same mistake has the same code here and there. All are `MlswarpError`;
those about arguments are `ValueError` or `TypeError` too.
"""

from __future__ import annotations

import json
from typing import Any

__all__ = [
    "ApiError",
    "AuthenticationError",
    "BadImage",
    "BadLandmarks",
    "ConnectionFailed",
    "FoldedError",
    "InternalError",
    "InvalidWarp",
    "MlswarpError",
    "Overloaded",
    "PermissionDenied",
    "RateLimited",
    "RequestTimeout",
    "SessionExpired",
    "SessionNotFound",
    "Superseded",
    "TooLarge",
    "UnsupportedArray",
]


class MlswarpError(Exception):
    """An error of this package."""

    code: str
    """A stable name, such as ``shape_mismatch``."""
    detail: str
    """One sentence: what is wrong, and where."""
    pointer: str | None
    """JSON pointer into the warp object, such as ``/q/3``."""
    handle: int | None
    """Index of the handle."""
    limit_name: str | None
    """Which limit is exceeded."""
    limit: Any
    """Its value."""
    actual: Any
    """The value that was given or found."""
    status: int | None = None
    """The HTTP status, if a server says so."""
    request_id: str | None = None
    """What the server's log calls the request."""
    retry_after: float | None = None
    """Seconds after which the request may be repeated."""

    def __init__(
        self,
        detail: str,
        *,
        code: str = "bad_value",
        pointer: str | None = None,
        handle: int | None = None,
        limit_name: str | None = None,
        limit: Any = None,
        actual: Any = None,
    ) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.pointer = pointer
        self.handle = handle
        self.limit_name = limit_name
        self.limit = limit
        self.actual = actual

    def __str__(self) -> str:
        place = f" (at {self.pointer})" if self.pointer else ""
        return f"{self.code}: {self.detail}{place}"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.__dict__)


class InvalidWarp(MlswarpError, ValueError):
    """Handles or parameters that are wrong, or do not go together."""


class FoldedError(MlswarpError, ValueError):
    """The warp folds over itself, and ``folds="reject"`` was asked for."""


class TooLarge(MlswarpError, ValueError):
    """More than a limit."""


class BadImage(MlswarpError, ValueError):
    """A file that is no image, is damaged, or has a format that is not read."""


class BadLandmarks(MlswarpError, ValueError):
    """A landmark file that cannot be read; the sentence has line and column."""


class UnsupportedArray(MlswarpError, TypeError):
    """An array of a type or shape that is not an image here. Warp it by `Pose.map`."""


class InternalError(MlswarpError):
    """A fault of this package or of the server. Please report it."""


class ApiError(MlswarpError):
    """A server refuses a request for reasons of its own; `status` has the HTTP status. Mistakes in
    handles, parameters and files are the same classes as in the process."""


class AuthenticationError(ApiError):
    """401: no key, a wrong one, or a token that has expired."""


class PermissionDenied(ApiError):
    """403: the key or token does not allow this."""


class SessionNotFound(ApiError):
    """404: no such session or layer."""


class Superseded(ApiError):
    """409: a newer pose of the session has been drawn. Never repeated."""


class SessionExpired(ApiError):
    """410: the session was idle for too long."""


class RateLimited(ApiError):
    """429: too many requests, also after repetitions."""


class Overloaded(ApiError):
    """503: the server has too much to do, also after repetitions."""


class ConnectionFailed(ApiError):
    """No answer: the server cannot be reached, or the connection broke."""


class RequestTimeout(ConnectionFailed):
    """No answer in time."""


_CLASSES: dict[str, type[MlswarpError]] = {
    "bad_image": BadImage,
    "bad_landmarks": BadLandmarks,
    "folded": FoldedError,
    "internal": InternalError,
    "too_large": TooLarge,
    "unsupported_array": UnsupportedArray,
    "unsupported_format": BadImage,
}


_OF_STATUS: dict[int, type[MlswarpError]] = {
    401: AuthenticationError,
    403: PermissionDenied,
    404: SessionNotFound,
    409: Superseded,
    410: SessionExpired,
    429: RateLimited,
    500: InternalError,
    503: Overloaded,
}
_MISTAKES = (413, 415, 422)


def of_problem(document: str) -> MlswarpError:
    """The exception of a problem document (RFC 9457) of the engine."""
    problem: dict[str, Any] = json.loads(document)
    return _made(_CLASSES.get(str(problem["code"]), InvalidWarp), problem)


def of_answer(status: int, problem: dict[str, Any]) -> MlswarpError:
    """The exception of a problem document of a server."""
    if status in _MISTAKES:
        kind = _CLASSES.get(str(problem.get("code")), InvalidWarp)
    else:
        kind = _OF_STATUS.get(status, ApiError)
    error = _made(kind, problem)
    error.status = status
    error.request_id = problem.get("request_id")
    error.retry_after = problem.get("retry_after")
    return error


def _made(kind: type[MlswarpError], problem: dict[str, Any]) -> MlswarpError:
    fields = ("pointer", "handle", "limit_name", "limit", "actual")
    given = {name: problem[name] for name in fields if name in problem}
    return kind(str(problem["detail"]), code=str(problem["code"]), **given)


def _restored(kind: type[MlswarpError], state: dict[str, Any]) -> MlswarpError:
    error = kind(state["detail"])
    error.__dict__.update(state)
    return error
