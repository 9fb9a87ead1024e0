from typing import Any, Literal

from .._pose import Fill

__all__ = ["MlsWarp"]

# A transform of albumentations, which has no types.
class MlsWarp:
    def __init__(
        self,
        sigma: float = 8.0,
        grid: tuple[int, int] = (4, 4),
        method: Literal["rigid", "similarity", "affine", "tps"] = "rigid",
        fill: Fill = 0,
        p: float = 0.5,
    ) -> None: ...
    def __call__(self, *args: Any, **data: Any) -> dict[str, Any]: ...
