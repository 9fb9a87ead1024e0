"""One pose, and everything that follows from it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _engine
from ._values import (
    Coordinates,
    Image,
    ImageArray,
    check_size,
    fill_out,
    image_array,
    mask_array,
    of_json_handles,
    positions,
    shape_of,
    to_json,
)
from .errors import InvalidWarp, TooLarge, UnsupportedArray

if TYPE_CHECKING:
    from ._plan import Plan

Fill: TypeAlias = int | tuple[int, ...] | str
Canvas: TypeAlias = Literal["same", "fit"] | tuple[int, int, int, int]


@dataclass(frozen=True)
class Report:
    """How good a pose is; the names are those of the service's ``/report``."""

    residuals: tuple[float | None, ...]
    folds: Mapping[str, Any]
    mirrored: bool
    area_factor: Mapping[str, float] | None
    shear: Mapping[str, float] | None
    covered: float
    tolerance: Mapping[str, Any] | None
    coincident: tuple[Mapping[str, Any], ...]
    round_trip: Mapping[str, Any]
    align: Mapping[str, Any] | None
    warnings: tuple[Mapping[str, Any], ...]


def report_of(answer: Mapping[str, Any]) -> Report:
    kept: dict[str, Any] = {name: answer.get(name) for name in Report.__dataclass_fields__}
    for name in ("residuals", "coincident", "warnings"):
        kept[name] = tuple(kept[name] or ())
    return Report(**kept)


class Pose:
    """The mesh of one pose: images, masks, points and maps follow from it.

    Made by `Plan.pose` and `Plan.jitter`. Immutable, for all threads, and picklable.
    """

    __slots__ = ("_folds", "_native", "_plan", "_process")

    _plan: Plan
    _native: _engine.Pose
    _folds: str
    _process: int

    def __init__(self) -> None:
        raise TypeError("a pose is made by Plan.pose")

    @classmethod
    def _of(cls, plan: Plan, native: _engine.Pose, folds: str = "report") -> Pose:
        pose = cls.__new__(cls)
        pose._plan = plan
        pose._native = native
        pose._folds = folds
        pose._process = os.getpid()
        return pose

    @classmethod
    def _restored(cls, plan: Plan, q: str, folds: str) -> Pose:
        native = plan._live().settled(f'{{"q":{q}}}'.encode(), folds)
        return cls._of(plan, native, folds)

    def __reduce__(self) -> tuple[Any, ...]:
        return Pose._restored, (self._plan, self._native.q, self._folds)

    def __repr__(self) -> str:
        return f"<mlswarp.Pose of {self._plan!r}, {self.folds} folded cells>"

    def _live(self) -> _engine.Pose:
        # As of `Plan._live`.
        if self._process != os.getpid():
            self._native = Pose._restored(self._plan, self._native.q, self._folds)._native
            self._process = os.getpid()
        return self._native

    @property
    def plan(self) -> Plan:
        """The handles at rest."""
        return self._plan

    @property
    def q(self) -> tuple[Any, ...]:
        """The posed handles: aligned, and at the strength that was asked for."""
        return of_json_handles(self._native.q)

    @property
    def folds(self) -> int:
        """The number of drawn cells that fold."""
        return self._native.folds

    @property
    def residual(self) -> float | None:
        """The largest distance of a posed handle from where it is drawn, px."""
        return self._native.residual

    @property
    def warnings(self) -> tuple[str, ...]:
        """Codes of what is valid and probably not meant, such as ``looks_normalized``."""
        return tuple(self._native.warnings)

    def warp(
        self,
        image: Image,
        *,
        fill: Fill = 0,
        filter: Literal["bilinear", "nearest", "bicubic"] = "bilinear",
        region: Image | None = None,
        canvas: Canvas = "same",
        width: int | None = None,
        out: ImageArray | None = None,
    ) -> ImageArray:
        """The image in this pose: the same type and the same number of channels, always.

        `fill`: what is where the posed image is not: a number, one for each colour, ``"edge"`` or
        ``"reflect"``. With 0 alpha is 0 there too. `region`: a mask of the image's size; only what
        is white in it moves. `canvas`, `width`: the part of the posed plane, (x, y, width, height)
        or ``"fit"``, and the width of the result. `out`: an array that takes the result.
        """
        array = image_array(image)
        check_size(array, self._plan.size, "image")
        mask = None
        if region is not None:
            mask = mask_array(region, "region")
            check_size(mask, self._plan.size, "region")
        output = _output(canvas, width, filter=filter, outside=_outside(fill, shape_of(array)[2]))
        of_mask = None if mask is None else (mask, shape_of(mask))
        made, _ = self._live().warp(array, shape_of(array), output, of_mask)
        if array.ndim == 2:
            made = made[:, :, 0]
        if out is not None:
            return fill_out(out, made)
        kind = np.asarray(image).dtype
        return made if made.dtype == kind else made.astype(kind)

    def labels(self, labels: Any, *, canvas: Canvas = "same", width: int | None = None) -> Any:
        """Labels in this pose: any integers or booleans, ``(H, W)``, moved and never mixed; 0 where
        nothing is."""
        array = np.asarray(labels)
        if array.dtype.kind not in "bui" or array.ndim != 2:
            raise UnsupportedArray(
                f"labels: expected integers or booleans, (H, W); found {array.dtype}, "
                f"{array.shape}",
                code="unsupported_array",
            )
        check_size(array, self._plan.size, "labels")
        carried, back = _carried(array)
        height, wide = array.shape
        moved = self._live().labels(carried, (height, wide), _output(canvas, width))
        if back is not None:
            return back[moved].astype(array.dtype, copy=False)
        return moved.view(array.dtype.newbyteorder("=")).astype(array.dtype, copy=False)

    def coverage(self, *, canvas: Canvas = "same", width: int | None = None) -> NDArray[np.uint8]:
        """How much of each pixel the posed image covers, 0 to 255."""
        return self._live().coverage(_output(canvas, width))[:, :, 0]

    def points(self, xy: Coordinates, *, inverse: bool = False) -> NDArray[np.float64]:
        """Where positions go, exactly; with `inverse`, which positions go there. As many rows as
        there were; NaN where nothing maps, and for NaN."""
        return self._live().points(positions(xy), inverse)

    def boxes(self, ltrb: ArrayLike, *, inverse: bool = False) -> NDArray[np.float64]:
        """The boxes around what is in boxes: left, top, right, bottom, ``(n, 4)``. Their edges are
        followed, not only their corners. NaN where nothing maps, and for NaN."""
        given = np.asarray(ltrb, dtype=np.float64).reshape(-1, 4)
        rows = [None if np.isnan(row).any() else row.tolist() for row in given]
        _require_finite(given, "boxes")
        mapped = self._annotations(boxes=rows, inverse=inverse)["boxes"]
        found = [[np.nan] * 4 if row is None else row for row in mapped]
        return np.array(found, dtype=np.float64).reshape(-1, 4)

    def polygons(
        self, polygons: Sequence[Coordinates | None], *, refine: bool = True, inverse: bool = False
    ) -> list[NDArray[np.float64] | None]:
        """Polygons with more vertices where the warp bends an edge (`refine`); `None` where a
        vertex maps nowhere."""
        given = [None if one is None else positions(one) for one in polygons]
        for one in given:
            if one is not None:
                _require_finite(one, "polygons", allow_nan=False)
        rows = [None if one is None else one.tolist() for one in given]
        mapped = self._annotations(polygons=rows, refine=refine, inverse=inverse)["polygons"]
        return [None if one is None else np.array(one, dtype=np.float64) for one in mapped]

    def geojson(self, geojson: Mapping[str, Any], *, inverse: bool = False) -> dict[str, Any]:
        """GeoJSON with its positions mapped; properties stay."""
        mapped = self._annotations(geojson=geojson, inverse=inverse)["geojson"]
        return dict(mapped)

    def _annotations(self, **request: Any) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(self._live().annotations(to_json(request)))
        return answer

    def map(self, *, direction: Literal["inverse", "forward"] = "inverse") -> NDArray[np.float32]:
        """A position for each pixel, ``(H, W, 2)``, as indices: (0, 0) is the first pixel.
        ``inverse``: which pixel of the image is shown there, for `cv2.remap` and
        `scipy.ndimage.map_coordinates`; ``forward``: where it goes. NaN where nothing is."""
        if direction not in ("inverse", "forward"):
            raise InvalidWarp(f"expected 'inverse' or 'forward'; found {direction!r}")
        made = self._live().map(direction == "forward")
        made -= np.float32(0.5)
        return made

    def mesh(self) -> NDArray[np.float32]:
        """The posed vertices of the grid, ``(rows, columns, 2)``, px.

        The order of drawing (`depth`) is not in it.
        """
        return self._live().mesh()

    def report(self) -> Report:
        """How good the pose is: residuals, folds, distortion."""
        return report_of(json.loads(self._live().report()))

    def for_skimage(self) -> Any:
        """An `inverse_map` for `skimage.transform.warp`: takes and returns ``(M, 2)`` (column, row)
        indices. What nothing maps to lies outside of every image."""
        far = -1e6

        def inverse_map(indices: ArrayLike) -> NDArray[np.float64]:
            centres = np.asarray(indices, dtype=np.float64) + 0.5
            return np.nan_to_num(self.points(centres, inverse=True) - 0.5, nan=far)

        return inverse_map


def _require_finite(array: NDArray[np.float64], name: str, *, allow_nan: bool = True) -> None:
    wrong = np.isinf(array) if allow_nan else ~np.isfinite(array)
    if wrong.any():
        row = int(np.argwhere(wrong)[0][0])
        raise InvalidWarp(
            f"expected numbers; found {array[row].tolist()}",
            code="not_finite",
            pointer=f"/{name}/{row}",
        )


def _outside(fill: Fill, samples: int) -> Any:
    if isinstance(fill, str):
        if fill.startswith("#") and samples < 3:
            raise InvalidWarp(
                f"fill: expected a number, because the image is grey; found {fill!r}",
                pointer="/output/outside",
            )
        return fill
    if isinstance(fill, (int, np.integer)):
        return None if fill == 0 else {"value": int(fill)}
    numbers = [int(number) for number in fill]
    if len(numbers) == 1:
        return {"value": numbers[0]}
    if samples < 3:
        raise InvalidWarp(
            f"fill: expected one number, because the image is grey; found {len(numbers)}",
            pointer="/output/outside",
        )
    return {"value": numbers}


def _output(canvas: Canvas, width: int | None, **more: Any) -> bytes:
    part: Any = canvas
    if not isinstance(canvas, str):
        part = dict(zip(("x", "y", "width", "height"), canvas, strict=True))
    output = {"canvas": part, "width": width, **more}
    return to_json({"output": {name: one for name, one in output.items() if one is not None}})


def _carried(array: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Labels of at most 32 bits as they are; others by their number among the different ones."""
    native = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
    if native.dtype.itemsize <= 4:
        return native.view(f"u{native.dtype.itemsize}"), None
    different, numbers = np.unique(native, return_inverse=True)
    if different.size >= 2**32:
        raise TooLarge("more different labels than 2^32", code="too_large")
    # The first is 0, which is drawn where nothing is.
    back = np.concatenate([np.zeros(1, native.dtype), different])
    return (numbers.reshape(native.shape) + 1).astype(np.uint32), back
