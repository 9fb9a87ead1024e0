"""Arrays and handles, to what the engine takes and back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidWarp, UnsupportedArray

Coordinates: TypeAlias = ArrayLike
"""``(n, 2)``: x, then y, in px; ``(0.5, 0.5)`` is the centre of the first pixel."""
Handles: TypeAlias = Any
"""Points as an ``(n, 2)`` array; or a list of handles, each ``[x, y]`` (a point),
``[[x, y], [x, y], ...]`` (a line) or ``None`` (a handle whose position is missing)."""
Image: TypeAlias = Any
"""An array of ``uint8`` or ``uint16``, ``(H, W)`` or ``(H, W, 1 | 2 | 3 | 4)``, or what NumPy makes
one of: an image of PIL, a tensor on the CPU."""
ImageArray: TypeAlias = NDArray[Any]
"""An array of ``uint8`` or ``uint16``."""

_HOW_ELSE = (
    "; warp other arrays by the map: cv2.remap(array, *np.moveaxis(pose.map(), 2, 0), "
    "cv2.INTER_LINEAR), or scipy.ndimage.map_coordinates, channel by channel"
)


def size_of(like: Any) -> tuple[int, int]:
    """Width and height of an image."""
    size = getattr(like, "size", None)
    if isinstance(size, tuple) and len(size) == 2 and not hasattr(like, "shape"):
        return int(size[0]), int(size[1])
    shape = np.asarray(like).shape if not hasattr(like, "shape") else tuple(like.shape)
    if len(shape) not in (2, 3):
        raise UnsupportedArray(
            f"expected an image, (H, W) or (H, W, channels); found the shape {shape}",
            code="unsupported_array",
        )
    return int(shape[1]), int(shape[0])


def json_handles(handles: Handles, name: str) -> list[Any]:
    """Handles as a warp object has them. NumPy's numbers become Python's; a point that is NaN is a
    handle whose position is missing."""
    if isinstance(handles, (str, bytes, Mapping)) or not hasattr(handles, "__iter__"):
        raise InvalidWarp(f"expected a list of handles; found {handles!r}", pointer=f"/{name}")
    if hasattr(handles, "__array__"):
        handles = np.asarray(handles).tolist()
    return [_json_handle(handle, name, index) for index, handle in enumerate(handles)]


def _json_handle(handle: Any, name: str, index: int) -> Any:
    if handle is None:
        return None
    value = _plain(handle)
    if isinstance(value, list) and value and all(_is_nan(number) for number in value):
        return None
    if _has_no_number(value):
        raise InvalidWarp(
            f"expected numbers; found {value!r}",
            code="not_finite",
            pointer=f"/{name}/{index}",
            handle=index,
        )
    return value


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _has_no_number(value: Any) -> bool:
    if isinstance(value, list):
        return any(_has_no_number(item) for item in value)
    return isinstance(value, float) and not math.isfinite(value)


def to_json(value: Any) -> bytes:
    """JSON of Python's and NumPy's values, which has neither NaN nor infinities."""
    try:
        text = json.dumps(value, default=_of_numpy, separators=(",", ":"), allow_nan=False)
    except ValueError:
        _refuse_no_number(value, "")
        raise
    return text.encode()


def _refuse_no_number(value: Any, pointer: str) -> None:
    value = _plain(value)
    if isinstance(value, Mapping):
        for name, member in value.items():
            _refuse_no_number(member, f"{pointer}/{name}")
    elif isinstance(value, list):
        for index, member in enumerate(value):
            _refuse_no_number(member, f"{pointer}/{index}")
    elif _has_no_number(value):
        raise InvalidWarp(
            f"expected a finite number; found {value!r}", code="not_finite", pointer=pointer
        )


def _of_numpy(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"expected JSON; found {type(value).__name__}")


def of_json_handles(text: str) -> tuple[Any, ...]:
    return tuple(json.loads(text))


def image_array(image: Image, name: str = "image") -> NDArray[Any]:
    """Rows without gaps, in the byte order of this machine."""
    array = np.asarray(image)
    kind = array.dtype
    if kind.kind != "u" or kind.itemsize > 2:
        raise UnsupportedArray(
            f"{name}: expected uint8 or uint16; found {kind}{_HOW_ELSE}", code="unsupported_array"
        )
    if array.ndim not in (2, 3) or array.ndim == 3 and array.shape[2] not in (1, 2, 3, 4):
        raise UnsupportedArray(
            f"{name}: expected the shape (H, W) or (H, W, 1 to 4); found {array.shape}{_HOW_ELSE}",
            code="unsupported_array",
        )
    return np.ascontiguousarray(array, dtype=kind.newbyteorder("="))


def shape_of(array: NDArray[Any]) -> tuple[int, int, int]:
    """Height, width and samples of a pixel."""
    height, width = array.shape[:2]
    return height, width, array.shape[2] if array.ndim == 3 else 1


def mask_array(mask: Image, name: str) -> NDArray[Any]:
    """Booleans as 0 and 255; anything else as an image."""
    array = np.asarray(mask)
    if array.dtype == np.bool_:
        return np.ascontiguousarray(array).view(np.uint8) * np.uint8(255)
    return image_array(array, name)


def check_size(array: NDArray[Any], expected: tuple[int, int], name: str) -> None:
    height, width = array.shape[:2]
    if (width, height) != expected:
        raise InvalidWarp(
            f"{name}: expected {expected[0]} x {expected[1]} px, the size of the plan; found "
            f"{width} x {height}",
            code="bad_value",
        )


def positions(xy: Coordinates) -> NDArray[np.float64]:
    array = np.ascontiguousarray(xy, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        raise InvalidWarp(
            f"expected positions, (n, 2); found the shape {array.shape}",
            code="shape_mismatch",
            pointer="/points",
        )
    return array


def fill_out(out: NDArray[Any], made: NDArray[Any]) -> NDArray[Any]:
    """Puts a result into the array of a caller."""
    if out.shape != made.shape or out.dtype != made.dtype:
        raise UnsupportedArray(
            f"out: expected {made.dtype} of the shape {made.shape}; found {out.dtype}, {out.shape}",
            code="unsupported_array",
        )
    if not out.flags.writeable:
        raise UnsupportedArray("out: the array is read-only", code="unsupported_array")
    out[...] = made
    return out


def from_centers(xy: Coordinates) -> NDArray[np.float64]:
    """Positions of programs that have the centre of the first pixel at (0, 0): OpenCV, dlib,
    scikit-image, keypoints of albumentations.

    >>> from_centers([[0, 0]])
    array([[0.5, 0.5]])
    """
    return np.asarray(xy, dtype=np.float64) + 0.5


def to_centers(xy: Coordinates) -> NDArray[np.float64]:
    """Positions for programs that have the centre of the first pixel at (0, 0).

    >>> to_centers([[0.5, 0.5]])
    array([[0., 0.]])
    """
    return np.asarray(xy, dtype=np.float64) - 0.5
