"""Averages, morphs, caricatures, transforms and symmetric faces: one sum over several images."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from . import _engine
from ._pose import Canvas, Fill, _output, _outside
from ._values import (
    Handles,
    Image,
    ImageArray,
    image_array,
    json_handles,
    shape_of,
    to_json,
)
from .errors import InvalidWarp

Shares: TypeAlias = Sequence[float] | Sequence[Sequence[float]]
"""A share for each image, or for each image a list: one share for each frame. They add up to 1."""


@dataclass(frozen=True)
class Blended:
    """One result of a blend."""

    image: ImageArray
    """With alpha, if an image has it or does not cover the result."""
    landmarks: tuple[Any, ...]
    """Where the landmarks are in it, px of the first image."""
    clamped: int
    """Samples that were cut off below 0 or above the largest value."""
    folds: tuple[int, ...]
    """Drawn cells that fold, for each image; with `mirror`, for each image and then its mirror
    image."""


def blend(
    images: Sequence[Image],
    landmarks: Sequence[Handles],
    *,
    shape: Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    **options: Any,
) -> Blended:
    """Brings the landmarks of all images to one shape, and adds the images, as ``POST /blend``.

    The default method is `affine` with alpha 2, as on the page; that of the route is `rigid`.

    `shape`, `colour`: the share of each image, equal ones if nothing is given; a negative share
    exaggerates. The mean of all is ``blend(images, landmarks)``; half way from the first image to
    the second, in shape alone, ``shape=[0.5, 0.5], colour=[1, 0]``; a caricature at 50 % of a face
    against the mean of others ``shape=[1.5, -0.5], colour=[1.5, -0.5]``; a symmetric face
    ``blend([face], [landmarks], mirror=True)``. `options`: those of `blend_frames`.

    >>> import numpy as np
    >>> dark, light = (np.full((40, 60, 3), value, np.uint8) for value in (40, 80))
    >>> p = [[10, 10], [50, 10], [30, 30]]
    >>> blend([dark, light], [p, p]).image[20, 30].tolist()
    [60, 60, 60]
    """
    if options.get("steps") is not None:
        raise InvalidWarp("blend makes one image: use blend_frames for steps", pointer="/steps")
    frames = list(blend_frames(images, landmarks, shape=shape, colour=colour, **options))
    if len(frames) != 1:
        raise InvalidWarp(
            "one share for each image is expected, not one for each frame: use blend_frames"
        )
    return frames[0]


def blend_frames(
    images: Sequence[Image],
    landmarks: Sequence[Handles],
    *,
    shape: Shares | None = None,
    colour: Shares | None = None,
    steps: int | None = None,
    mirror: bool = False,
    pairs: Sequence[int] | None = None,
    names: Sequence[Sequence[str]] | None = None,
    align: Literal["none", "rigid", "similarity", "affine"] = "similarity",
    reference: int | Literal["mean"] | Handles = 0,
    space: Literal["srgb", "linear"] = "srgb",
    match: Literal["name", "order"] | None = None,
    method: str = "affine",
    alpha: float | None = None,
    fill: Fill = 0,
    filter: Literal["bilinear", "nearest", "bicubic"] = "bilinear",
    canvas: Canvas = "same",
    width: int | None = None,
    **more: Any,
) -> Iterator[Blended]:
    """The frames of a blend, one after another: `steps` from the first image to the second, or one
    for each of the shares in lists. Coefficients are computed once for all of them.

    `landmarks`: of each image, px. `mirror`: every image is joined by its mirror image, which takes
    half of its shares; `pairs`: for each landmark the index of its mirror image, otherwise they are
    found by `names` or by position. `align`, `reference`: the class of maps that brings shapes
    together, and the image, shape or mean that they are brought to. `space`: what is added, samples
    or light. `match`: landmarks by `names` or by their order. `method`, `alpha`, and in `more`
    `point_mass`, `smoothing`, `coincident`, `grid`: as of `Plan`, without weights and depth of
    handles; alpha is 2 where a method has one. `fill`, `filter`, `canvas`, `width`: as of
    `Pose.warp`. With `mirror`, problems count each image and then its mirror image.
    """
    arrays = [image_array(image, f"images[{index}]") for index, image in enumerate(images)]
    if len(arrays) != len(landmarks) or not arrays:
        raise InvalidWarp(
            f"expected landmarks for each of {len(arrays)} images; found {len(landmarks)}",
            pointer="/images",
        )
    entries = _entries(len(arrays), landmarks, (shape, colour), names, mirror, pairs)
    output = _output(canvas, width, filter=filter, outside=_outside(fill, shape_of(arrays[0])[2]))
    if alpha is None and method in ("rigid", "similarity", "affine"):
        alpha = 2.0
    options = {
        "steps": steps,
        "align": align,
        "reference": _reference(reference),
        "space": space,
        "match": match,
        "method": method,
        "alpha": alpha,
        **json.loads(output),
        **more,
    }
    given = {name: value for name, value in options.items() if value is not None}
    native = _engine.Blend(
        [(array, shape_of(array)) for array in arrays], to_json({"images": entries, **given})
    )
    return (_blended(native, k) for k in range(native.frames))


def _entries(
    count: int,
    landmarks: Sequence[Handles],
    shares: tuple[Shares | None, Shares | None],
    names: Sequence[Sequence[str]] | None,
    mirror: bool,
    pairs: Sequence[int] | None,
) -> list[dict[str, Any]]:
    entries = []
    if names is not None and len(names) != count:
        raise InvalidWarp(
            f"names: expected a list for each of {count} images; found {len(names)}",
            pointer="/images",
        )
    for index in range(count):
        entry: dict[str, Any] = {"image": index, "p": json_handles(landmarks[index], "p")}
        if names is not None:
            entry["names"] = list(names[index])
        for name, of_all in zip(("shape", "colour"), shares, strict=True):
            if of_all is None:
                continue
            if len(of_all) != count:
                raise InvalidWarp(
                    f"{name}: expected a share for each of {count} images; found {len(of_all)}",
                    pointer="/images",
                )
            own = np.asarray(of_all[index], dtype=np.float64)
            entry[name] = (own / 2 if mirror else own).tolist()
        entries.append(entry)
        if mirror:
            entries.append({**entry, "mirror": True, **({} if pairs is None else {"pairs": pairs})})
    return entries


def _reference(reference: Any) -> Any:
    if isinstance(reference, (str, int, np.integer)):
        return reference if isinstance(reference, str) else int(reference)
    return json_handles(reference, "reference")


def _blended(native: _engine.Blend, frame: int) -> Blended:
    image, landmarks, report = native.frame(frame)
    found = json.loads(report)
    return Blended(
        image=image[:, :, 0] if image.shape[2] == 1 else image,
        landmarks=tuple(json.loads(landmarks)),
        clamped=found["clamped"],
        folds=tuple(found["folds"]),
    )
