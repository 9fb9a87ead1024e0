"""Files as the service has them: an image and a warp object in, an image file out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias

from . import _engine
from ._plan import _size
from ._values import to_json

File: TypeAlias = bytes | bytearray | memoryview | str | PathLike[str]
"""The bytes of a file, or its path."""


@dataclass(frozen=True)
class Landmarks:
    """Handles of a landmark file, in px of the image: as `Plan` and `Plan.pose` take them."""

    p: tuple[Any, ...]
    q: tuple[Any, ...] | None
    """`None` if the file has positions of one side."""
    names: tuple[str, ...] | None
    units: str
    format: str
    """What was read."""
    unmatched: Mapping[str, list[str]]
    """Names that only one side has."""


def _read(file: File) -> bytes:
    if isinstance(file, (bytes, bytearray, memoryview)):
        return bytes(file)
    return Path(file).read_bytes()


def warp_file(
    image: File, warp: Mapping[str, Any] | str | bytes, *, region: File | None = None
) -> bytes:
    """An image file drawn as ``POST /warp`` of the service does: the same bytes.

    `warp`: a warp object with `p`, `q` and anything else of it, or its JSON. `region`: the file of
    a mask. Unlike `Pose.warp`, the result has an alpha channel if the image does not cover it.
    """
    text = warp if isinstance(warp, bytes) else warp.encode() if isinstance(warp, str) else None
    return _engine.warp_file(
        _read(image),
        to_json(warp) if text is None else text,
        None if region is None else _read(region),
    )


def load_landmarks(
    file: File,
    file_q: File | None = None,
    *,
    size: tuple[int, int] | None = None,
    size_p: tuple[int, int] | None = None,
    size_q: tuple[int, int] | None = None,
    match: Literal["name", "order"] | None = None,
    item: str | None = None,
) -> Landmarks:
    """Reads landmark files of other programs: the formats that the service reads, recognised by
    their content.

    One file with both sides or one; or `file` at rest and `file_q` posed. `size`: of the image,
    which normalised positions are multiplied by; `size_p`, `size_q`: of the images that the
    positions were placed on.
    """
    sizes = [None if one is None else _size(one) for one in (size, size_p, size_q)]
    text = _engine.read_landmarks(
        _read(file),
        None if file_q is None else _read(file_q),
        sizes[0],
        (sizes[1], sizes[2]),
        match,
        item,
    )
    found = json.loads(text)
    q, names = found.get("q"), found.get("names")
    return Landmarks(
        p=tuple(found["p"]),
        q=None if q is None else tuple(q),
        names=None if names is None else tuple(names),
        units=found["units"],
        format=found["format"],
        unmatched=found.get("unmatched", {}),
    )
