"""Handles at rest, and their poses."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _engine
from ._pose import Pose
from ._values import (
    Handles,
    Image,
    check_size,
    image_array,
    json_handles,
    mask_array,
    of_json_handles,
    shape_of,
    size_of,
    to_json,
)
from .errors import InvalidWarp, UnsupportedArray

_Buffer: TypeAlias = tuple[NDArray[Any], tuple[int, int, int]]

_MOST_SIGMA = 10_000.0
_MOST_FRAMES = 2**32 - 1


@dataclass(frozen=True)
class Candidate:
    """How well a method predicts points that it does not know."""

    method: str
    alpha: float | None
    smoothing: float | None
    rms: float | None
    """Root mean square of the residuals, px; `None` if no point could be left out."""
    max: float | None
    """The largest residual, px."""
    residuals: NDArray[np.float64]
    """``(n, 2)``: from where the other points take each point to where it is; NaN without."""
    outliers: tuple[int, ...]
    """Points that the others contradict."""


@dataclass(frozen=True)
class FitReport:
    """The comparison of methods on landmarks."""

    best: Candidate | None
    candidates: tuple[Candidate, ...]


class Plan:
    """Handles at rest on an image of one size; what does not depend on a pose is computed once.

    Immutable, for all threads, and picklable: another process computes it again.

    `p`: points as an ``(n, 2)`` array, or a list of handles. x points right, y down, in px of the
    image, and the centre of the first pixel is (0.5, 0.5) (`from_centers` converts).
    `size`: width and height; or `like`, an image that has them.

    With `metric="geodesic"` handles act along the paths inside an outline, and `method="arap"`
    follows it: that of `mask`, booleans or numbers of the image's size of which what is white
    belongs to it, times the alpha of `like`; as a session's layer `region`, times the alpha of its
    image. `mask_threshold`: the share above which a pixel is inside, one half if not given. Give
    `Pose.warp` the mask as its `region` too if the rest of the image shall stay.

    Everything else is as in the warp object of the service.

    >>> import numpy as np
    >>> legs = np.ones((40, 60), bool)
    >>> legs[10:, 28:32] = False
    >>> plan = Plan([[14, 35], [46, 35]], size=(60, 40), metric="geodesic", mask=legs)
    >>> plan.pose([[20, 35], [46, 35]]).points([[46, 35]])
    array([[46., 35.]])
    """

    __slots__ = ("_json", "_native", "_outline", "_process", "_size", "_method")

    def __init__(
        self,
        p: Handles,
        *,
        size: tuple[int, int] | None = None,
        like: Image | None = None,
        method: Literal[
            "rigid", "similarity", "affine", "tps", "beier_neely", "arap", "global_affine"
        ] = "rigid",
        alpha: float | None = None,
        weights: ArrayLike | None = None,
        depth: ArrayLike | None = None,
        point_mass: float | None = None,
        smoothing: float | None = None,
        units: Literal["px", "normalized"] = "px",
        tolerance: float | None = None,
        align: Literal["none", "rigid", "similarity", "affine"] = "none",
        coincident: Mapping[str, Any] | None = None,
        metric: Literal["euclidean", "geodesic"] = "euclidean",
        mask: Image | None = None,
        mask_threshold: float | None = None,
        **more: Any,
    ) -> None:
        if (size is None) == (like is None):
            raise InvalidWarp("give the size of the image, or an image like it", pointer="/extent")
        warp = {
            "p": json_handles(p, "p"),
            "method": method,
            "alpha": alpha,
            "weights": None if weights is None else np.asarray(weights).tolist(),
            "depth": None if depth is None else np.asarray(depth).tolist(),
            "point_mass": point_mass,
            "smoothing": smoothing,
            "units": units,
            "grid": None if tolerance is None else {"tolerance": tolerance},
            "align": align,
            "coincident": coincident,
            "metric": metric,
            "mask": None if mask_threshold is None else {"threshold": mask_threshold},
            **more,
        }
        given = {name: value for name, value in warp.items() if value is not None}
        extent = size_of(like) if size is None else _size(size)
        follows = metric == "geodesic" or method == "arap"
        alpha_of_like = _alpha_of(like) if follows and like is not None else None
        inside = None if mask is None else _inside(mask, extent)
        self._settle(to_json(given), extent, (_buffer(alpha_of_like), _buffer(inside)))

    def _settle(
        self, warp: bytes, size: tuple[int, int], outline: tuple[_Buffer | None, _Buffer | None]
    ) -> None:
        self._json = warp
        self._size = size
        self._outline = outline
        self._method = str(json.loads(warp).get("method", "rigid"))
        self._compute()

    def _compute(self) -> None:
        self._native = _engine.Plan(self._json, self._size, *self._outline)
        self._process = os.getpid()

    @classmethod
    def _restored(cls, *parts: Any) -> Plan:
        plan = cls.__new__(cls)
        plan._settle(*parts)
        return plan

    def __reduce__(self) -> tuple[Any, ...]:
        return Plan._restored, (self._json, self._size, self._outline)

    def __repr__(self) -> str:
        width, height = self._size
        return f"<mlswarp.Plan of {len(self.p)} handles on {width} x {height} px, {self._method}>"

    def _live(self) -> _engine.Plan:
        # What a thread of the parent held when this process was forked stays held for ever.
        if self._process != os.getpid():
            self._compute()
        return self._native

    @property
    def p(self) -> tuple[Any, ...]:
        """The handles at rest."""
        return of_json_handles(self._live().p)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image."""
        return self._size

    @property
    def method(self) -> str:
        """How the image follows the handles."""
        return self._method

    @property
    def alpha(self) -> float | None:
        """The effective fall-off; `None` of methods that have none."""
        return self._live().alpha

    def pose(
        self,
        q: Handles,
        *,
        strength: float = 1.0,
        folds: Literal["report", "reject", "remove"] = "report",
    ) -> Pose:
        """The mesh of posed handles, as many and of the same kinds as those at rest.

        `strength`: 0 is at rest, 1 is `q`, 2 is twice as far. `folds`: a pose that folds
        over itself is a `FoldedError` with "reject", and with "remove" another map without folds
        takes the handles to the same places. `Pose.folds` counts the cells that fold.
        """
        if folds not in ("report", "reject", "remove"):
            expected = "'report', 'reject' or 'remove'"
            raise InvalidWarp(f"expected {expected}; found {folds!r}", pointer="/folds")
        request = to_json({"q": json_handles(q, "q"), "strength": float(strength)})
        return Pose._of(self, self._live().pose(request, folds), folds)

    def jitter(
        self,
        *,
        sigma: float,
        count: int,
        seed: int,
        q: Handles | None = None,
        strength: float = 1.0,
    ) -> Iterator[Pose]:
        """Random poses around `q`, or around the handles at rest: those of the service's ``/batch``
        with the same numbers, on every machine.

        `sigma`: the standard deviation of the displacements along each axis, px. Handles that are
        near each other move together.
        """
        if not 0.0 <= sigma <= _MOST_SIGMA:
            raise InvalidWarp(
                f"expected a number of pixels between 0 and 10000; found {sigma}",
                pointer="/jitter/sigma",
                actual=sigma,
            )
        if not 1 <= count <= _MOST_FRAMES:
            raise InvalidWarp(
                f"expected a whole number of frames, at least 1; found {count}",
                pointer="/jitter/count",
                actual=count,
            )
        if not 0 <= seed < 2**64:
            raise InvalidWarp(
                f"expected a whole number between 0 and 2^64 - 1; found {seed}",
                pointer="/jitter/seed",
                actual=seed,
            )
        given: dict[str, Any] = {} if q is None else {"q": json_handles(q, "q")}
        if q is not None:
            given["strength"] = float(strength)
        return self._frames(to_json(given), int(seed), float(sigma), int(count))

    def _frames(self, request: bytes, seed: int, sigma: float, count: int) -> Iterator[Pose]:
        for frame in range(count):
            settled = self._live().jitter(request, seed, sigma, frame)
            yield Pose._of(self, settled)

    @staticmethod
    def fit(
        p: Handles,
        q: Handles,
        size: tuple[int, int],
        *,
        candidates: Sequence[Mapping[str, Any]] | None = None,
        **more: Any,
    ) -> FitReport:
        """Compares methods by how well each predicts every landmark from the others.

        >>> import mlswarp
        >>> p = [[10, 10], [90, 10], [50, 50], [10, 90], [90, 90]]
        >>> report = mlswarp.Plan.fit(p, [[x + 3, y] for x, y in p], (100, 100))
        >>> report.best.rms < 1e-9
        True
        """
        request = {
            "p": json_handles(p, "p"),
            "q": json_handles(q, "q"),
            "extent": list(_size(size)),
            **({} if candidates is None else {"candidates": list(candidates)}),
            **more,
        }
        answer = json.loads(_engine.compare_methods(to_json(request)))
        found = tuple(_candidate(candidate) for candidate in answer["candidates"])
        names = ("method", "alpha", "smoothing")
        best = answer["best"]
        for one in found:
            if best and all(getattr(one, name) == best[name] for name in names):
                return FitReport(one, found)
        return FitReport(None, found)


def _alpha_of(like: Image) -> NDArray[Any] | None:
    """An image with the alpha of another; `None` of an opaque one."""
    array = image_array(like, "like")
    alpha = shape_of(array)[2] - 1
    return array[:, :, [alpha, alpha]] if alpha in (1, 3) else None


def _inside(mask: Image, size: tuple[int, int]) -> NDArray[Any]:
    array = np.array(mask_array(mask, "mask"))
    if array.ndim != 2:
        raise UnsupportedArray(
            f"mask: expected the shape (H, W); found {array.shape}", code="unsupported_array"
        )
    check_size(array, size, "mask")
    return array


def _buffer(array: NDArray[Any] | None) -> _Buffer | None:
    return None if array is None else (array, shape_of(array))


def _size(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError):
        raise InvalidWarp(
            f"expected a size, (width, height); found {size!r}", pointer="/extent"
        ) from None
    if min(width, height) < 1 or max(width, height) >= 2**32:
        raise InvalidWarp(
            f"expected a size in pixels, at least 1 each; found {size!r}", pointer="/extent"
        )
    return width, height


def _candidate(found: Mapping[str, Any]) -> Candidate:
    residuals = [[np.nan, np.nan] if one is None else one for one in found["residuals"]]
    return Candidate(
        found["method"],
        found["alpha"],
        found["smoothing"],
        found["rms"],
        found["max"],
        np.array(residuals, dtype=np.float64).reshape(-1, 2),
        tuple(found["outliers"]),
    )
