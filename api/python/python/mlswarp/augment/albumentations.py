"""`RandomWarp` as a transform of albumentations: 2.0.8, and albumentationsx with its own hook.

    A.Compose([MlsWarp(sigma=8)], bbox_params=..., keypoint_params=..., seed=7)

Images, masks, boxes and keypoints follow one pose. Keypoints are mapped exactly and none is lost;
their angle and scale stay. Labels of masks are never mixed.
"""

from __future__ import annotations

from typing import Any, Literal

import albumentations as A
import cv2
import numpy as np
from albumentations.core.type_definitions import Targets
from numpy.typing import NDArray

from .._pose import Fill, Pose
from . import RandomWarp

__all__ = ["MlsWarp"]


class _Targets(A.DualTransform):  # type: ignore[misc, unused-ignore]
    """What a pose does to each kind of data."""

    _targets = (Targets.IMAGE, Targets.MASK, Targets.BBOXES, Targets.KEYPOINTS)

    def __init__(
        self,
        sigma: float = 8.0,
        grid: tuple[int, int] = (4, 4),
        method: Literal["rigid", "similarity", "affine", "tps"] = "rigid",
        fill: Fill = 0,
        p: float = 0.5,
    ) -> None:
        super().__init__(p=p)
        self.sigma = sigma
        self.grid = grid
        self.method = method
        self.fill = fill
        self._warps = RandomWarp(sigma, grid=grid, method=method)

    def get_transform_init_args_names(self) -> tuple[str, ...]:
        return ("sigma", "grid", "method", "fill")

    def _sample(self, shape: tuple[int, ...], rng: np.random.Generator) -> Pose:
        return self._warps.sample(rng, (shape[1], shape[0]))

    def apply(self, img: NDArray[Any], pose: Pose, **_: Any) -> NDArray[Any]:
        is_plain = img.dtype in (np.uint8, np.uint16) and (img.ndim == 2 or img.shape[2] <= 4)
        if is_plain:
            return pose.warp(img, fill=self.fill)
        return _remap(img, pose, cv2.INTER_LINEAR)

    def apply_to_mask(self, mask: NDArray[Any], pose: Pose, **_: Any) -> NDArray[Any]:
        if mask.dtype.kind not in "bui":
            return _remap(mask, pose, cv2.INTER_NEAREST)
        if mask.ndim == 2:
            return np.asarray(pose.labels(mask))
        moved = [pose.labels(channel) for channel in np.moveaxis(mask, 2, 0)]
        return np.stack(moved, axis=2)

    def apply_to_keypoints(self, keypoints: NDArray[Any], pose: Pose, **_: Any) -> NDArray[Any]:
        moved = np.array(keypoints)
        # The centre of the first pixel is (0, 0) there.
        moved[:, :2] = pose.points(moved[:, :2].astype(np.float64) + 0.5) - 0.5
        return moved

    def apply_to_bboxes(self, bboxes: NDArray[Any], pose: Pose, **_: Any) -> NDArray[Any]:
        moved = np.array(bboxes)
        # Edges of pixels, as shares of the sides.
        sides = np.tile(pose.plan.size, 2)
        moved[:, :4] = pose.boxes(moved[:, :4].astype(np.float64) * sides) / sides
        return moved


def _remap(array: NDArray[Any], pose: Pose, how: int) -> NDArray[Any]:
    """Arrays that are no image here, channel by channel; 0 where nothing is."""
    x, y = np.moveaxis(np.nan_to_num(pose.map(), nan=-1e6), 2, 0)
    planes = [array] if array.ndim == 2 else np.moveaxis(array, 2, 0)
    moved = [cv2.remap(np.ascontiguousarray(plane), x, y, how) for plane in planes]
    return moved[0] if array.ndim == 2 else np.stack(moved, axis=2)


if hasattr(A.BasicTransform, "sample_parameters"):
    from albumentations.core.transform_params import SampledParams

    class MlsWarp(_Targets):
        """A smooth random warp: see `RandomWarp`."""

        def sample_parameters(
            self, params: dict[str, Any], data: dict[str, Any], targets: Any, sampling: Any
        ) -> Any:
            pose = self._sample(params["shape"], sampling.random_generator)
            return SampledParams(params={"pose": pose})

else:

    class MlsWarp(_Targets):  # type: ignore[no-redef]
        """A smooth random warp: see `RandomWarp`."""

        def get_params_dependent_on_data(
            self, params: dict[str, Any], data: dict[str, Any]
        ) -> dict[str, Any]:
            return {"pose": self._sample(params["shape"], self.random_generator)}
