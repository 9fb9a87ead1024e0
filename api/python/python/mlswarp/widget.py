"""A widget for notebooks (JupyterLab and others that run anywidget): handles on an image.

Needs the extra ``widget``: ``pip install 'mlswarp[widget]'``. The engine runs in the browser, so
that a drag asks nothing of the kernel; results are computed here.
"""

from __future__ import annotations

import gzip
from base64 import b64encode
from importlib.resources import files
from io import BytesIO
from os import PathLike
from typing import Any

import numpy as np

from ._files import _read
from ._plan import Plan
from ._pose import Pose
from ._values import Handles, Image, ImageArray, image_array, json_handles
from .errors import BadImage, InvalidWarp, TooLarge

try:
    import anywidget
    import traitlets
    from PIL import Image as Pictures
    from PIL import ImageOps
except ImportError as error:
    needed = "mlswarp.widget needs anywidget and Pillow: pip install 'mlswarp[widget]'"
    raise ImportError(needed) from error

__all__ = ["WarpWidget"]

# Those that need no outline.
_METHODS = ("rigid", "similarity", "affine", "tps", "global_affine", "beier_neely")


def _module() -> str:
    """The front: a notebook loads it from a blob, so that everything must be in it."""
    here = files("mlswarp")
    packed = gzip.compress((here / "_widget.wasm").read_bytes(), mtime=0)
    script = (here / "_widget.js").read_text(encoding="utf-8")
    return f'const MLSWARP_WASM = "{b64encode(packed).decode()}";\n{script}'


class _InvalidTrait(InvalidWarp, traitlets.TraitError):
    """What traitlets undoes the changes for."""


class _Handles(traitlets.TraitType[tuple[Any, ...], Handles]):
    """Handles as tuples: a list that is changed in place sends no event."""

    default_value = ()

    def validate(self, obj: Any, value: Handles) -> tuple[Any, ...]:
        name = str(self.name)
        try:
            handles = json_handles(value, name)
        except InvalidWarp as error:
            raise _InvalidTrait(error.detail, code=error.code, pointer=error.pointer) from None
        return tuple(_handle(handle, f"/{name}/{k}") for k, handle in enumerate(handles))


def _handle(handle: Any, pointer: str) -> tuple[Any, ...]:
    try:
        found = np.array(handle, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (2,) and not (found.ndim == 2 and len(found) > 1 and found.shape[1] == 2):
        detail = f"expected [x, y], or a list of two or more of these; found {handle!r}"
        raise _InvalidTrait(detail, pointer=pointer)
    return tuple(tuple(one) if found.ndim == 2 else one for one in found.tolist())


def _shape(handles: tuple[Any, ...]) -> list[tuple[int, ...]]:
    return [np.shape(handle) for handle in handles]


class WarpWidget(anywidget.AnyWidget):
    """An image whose handles are dragged.

    `image`: an array as `Pose.warp` takes it, an image of PIL, or a file (its bytes or its path).
    `p`: handles at rest; none, and the person adds them with clicks. `q`: where they are. `height`:
    CSS px.

    `p`, `q`, `method`, `strength` and `tool` (what a click adds: "point", "line" or "path") are
    traits: they follow the person, and may be set and observed. Handles are tuples; to change one,
    set all.

    >>> import numpy as np
    >>> widget = WarpWidget(np.zeros((300, 400, 3), np.uint8), p=[[100, 100], [300, 200]])
    >>> widget.observe(lambda change: print(change.new), "q")
    >>> widget.q = [[100, 100], [310, 190]]
    ((100.0, 100.0), (310.0, 190.0))
    >>> widget.result().shape
    (300, 400, 3)
    """

    _esm = _module()

    image_bytes = traitlets.Bytes(read_only=True).tag(sync=True)
    """What the browser shows: PNG or JPEG."""
    p = _Handles().tag(sync=True)
    q = _Handles().tag(sync=True)
    method = traitlets.Enum(_METHODS, "rigid").tag(sync=True)
    strength = traitlets.Float(1.0).tag(sync=True)
    tool = traitlets.Enum(("point", "line", "path"), "point").tag(sync=True)
    height = traitlets.Int(480, min=1).tag(sync=True)

    def __init__(
        self,
        image: Image | bytes | str | PathLike[str],
        p: Handles | None = None,
        q: Handles | None = None,
        *,
        method: str = "rigid",
        height: int = 480,
        strength: float = 1.0,
        tool: str = "point",
    ) -> None:
        self._image, file = _opened(image)
        self.set_trait("image_bytes", file)
        rest = () if p is None else p
        posed = rest if q is None else q
        given = {"method": method, "height": height, "strength": strength, "tool": tool}
        super().__init__(p=rest, q=posed, **given)

    @traitlets.validate("q")
    def _fitting(self, proposal: Any) -> tuple[Any, ...]:
        posed: tuple[Any, ...] = proposal["value"]
        if _shape(posed) != _shape(self.p):
            detail = "expected as many handles as in p, each with as many positions"
            raise _InvalidTrait(f"q: {detail}", code="shape_mismatch", pointer="/q")
        return posed

    @traitlets.observe("p")
    def _follow(self, _change: Any) -> None:
        if _shape(self.q) != _shape(self.p):
            self.q = self.p

    @property
    def value(self) -> dict[str, Any]:
        """The warp object, as `mlswarp.warp_file` and `mlswarp.Client.warp` take it."""
        return {name: getattr(self, name) for name in ("p", "q", "method", "strength")}

    def pose(self) -> Pose:
        """The pose that is shown, for masks and points of the image too."""
        plan = Plan(self.p, like=self._image, method=self.method)
        return plan.pose(self.q, strength=self.strength)

    def result(self) -> ImageArray:
        """The warped image, with the type and the shape of `image`; computed here, in full."""
        return self.pose().warp(self._image)


def _opened(image: Any) -> tuple[ImageArray, bytes]:
    """The pixels, and a file that browsers show."""
    if not isinstance(image, (bytes, bytearray, memoryview, str, PathLike)):
        # A copy: what is shown stays what results are made of.
        pixels = image_array(image).copy()
        if pixels.size == 0:
            raise BadImage(f"image: no pixels in the shape {pixels.shape}", code="bad_image")
        return pixels, _png(pixels)
    file = _read(image)
    try:
        with Pictures.open(BytesIO(file)) as picture:
            kind = picture.format
            pixels = _pixels(ImageOps.exif_transpose(picture))
    except Pictures.DecompressionBombError as error:
        raise TooLarge(f"image: {error}", code="too_large") from error
    # Of a file that is cut off, and of damaged chunks, besides those that are no image at all.
    except (OSError, SyntaxError, ValueError) as error:
        raise BadImage(f"image: Pillow cannot read it: {error}", code="bad_image") from error
    return pixels, file if kind in ("PNG", "JPEG") else _png(pixels)


def _pixels(picture: Pictures.Image) -> ImageArray:
    if picture.mode.startswith("I;16"):
        return np.asarray(picture).astype(np.uint16)
    if picture.mode not in ("L", "LA", "RGB", "RGBA"):
        picture = picture.convert("RGBA" if picture.has_transparency_data else "RGB")
    return np.asarray(picture)


def _png(pixels: ImageArray) -> bytes:
    shown = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)
    if shown.ndim == 3 and shown.shape[2] == 1:
        shown = shown[:, :, 0]
    out = BytesIO()
    # Fast: it goes to a browser that is near.
    Pictures.fromarray(shown).save(out, "PNG", compress_level=1)
    return out.getvalue()
