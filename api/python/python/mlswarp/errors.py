"""What can go wrong, by what the caller can change.

Every error has the service's ``code`` (``api/problems.md`` describes each), a sentence, and the
place in the warp object: the same mistake has the same code here and there. All are `MlswarpError`;
those about arguments are `ValueError` or `TypeError` too.
"""

from __future__ import annotations

import json
from typing import Any

__all__ = [
    "BadImage",
    "BadLandmarks",
    "FoldedError",
    "InternalError",
    "InvalidWarp",
    "MlswarpError",
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
    """A fault of this package. Please report it."""


_CLASSES: dict[str, type[MlswarpError]] = {
    "bad_image": BadImage,
    "bad_landmarks": BadLandmarks,
    "folded": FoldedError,
    "internal": InternalError,
    "too_large": TooLarge,
    "unsupported_array": UnsupportedArray,
    "unsupported_format": BadImage,
}


def of_problem(document: str) -> MlswarpError:
    """The exception of a problem document (RFC 9457), which the engine and the service have."""
    problem: dict[str, Any] = json.loads(document)
    code = str(problem["code"])
    fields = ("pointer", "handle", "limit_name", "limit", "actual")
    given = {name: problem[name] for name in fields if name in problem}
    return _CLASSES.get(code, InvalidWarp)(str(problem["detail"]), code=code, **given)


def _restored(kind: type[MlswarpError], state: dict[str, Any]) -> MlswarpError:
    error = kind(state["detail"])
    error.__dict__.update(state)
    return error
