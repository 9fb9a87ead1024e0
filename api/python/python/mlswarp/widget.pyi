from os import PathLike
from typing import Any, Literal, TypeAlias

import traitlets

from ._pose import Pose
from ._values import Handles, Image, ImageArray

__all__ = ["WarpWidget"]

_Method: TypeAlias = Literal[
    "rigid", "similarity", "affine", "tps", "global_affine", "beier_neely"
]
_Tool: TypeAlias = Literal["point", "line", "path"]

# Its traits, as they are read and set. A widget of anywidget, whose base has no types.
class WarpWidget(traitlets.HasTraits):
    method: _Method
    strength: float
    tool: _Tool
    height: int
    def __init__(
        self,
        image: Image | bytes | str | PathLike[str],
        p: Handles | None = None,
        q: Handles | None = None,
        *,
        method: _Method = "rigid",
        height: int = 480,
        strength: float = 1.0,
        tool: _Tool = "point",
    ) -> None: ...
    @property
    def image_bytes(self) -> bytes: ...
    @property
    def p(self) -> tuple[Any, ...]: ...
    @p.setter
    def p(self, handles: Handles) -> None: ...
    @property
    def q(self) -> tuple[Any, ...]: ...
    @q.setter
    def q(self, handles: Handles) -> None: ...
    @property
    def value(self) -> dict[str, Any]: ...
    def pose(self) -> Pose: ...
    def result(self) -> ImageArray: ...
