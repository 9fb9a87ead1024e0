"""Random warps for training data, for every library that has arrays.

`mlswarp.augment.albumentations` has them as a transform of albumentations.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from .._plan import Plan
from .._pose import Pose
from .._values import Handles
from ..errors import InvalidWarp

__all__ = ["RandomWarp"]

_KEPT_PLANS = 8
_MOST_ATTEMPTS = 8


class RandomWarp:
    """Smooth random warps, whose strength is known in pixels.

    `sigma`: the standard deviation of the displacements along each axis, px. `grid`: columns and
    rows of handles from corner to corner; neighbours move together over about the distance between
    them. Or `handles` of your own, such as landmarks, in px. `max_folds`: a warp with more folded
    cells is drawn again with half of sigma. Everything else is as in `Plan`.

    >>> import numpy as np
    >>> warp = RandomWarp(sigma=3)
    >>> pose = warp.sample(np.random.default_rng(7), (64, 48))
    >>> pose.warp(np.zeros((48, 64, 3), np.uint8)).shape, pose.folds
    ((48, 64, 3), 0)
    """

    def __init__(
        self,
        sigma: float,
        *,
        grid: tuple[int, int] = (4, 4),
        handles: Handles | None = None,
        max_folds: int = 0,
        **plan: Any,
    ) -> None:
        if min(grid) < 2:
            raise InvalidWarp(f"expected a grid of at least 2 x 2 handles; found {grid!r}")
        self.sigma: float = float(sigma)
        self.grid: tuple[int, int] = (int(grid[0]), int(grid[1]))
        self.max_folds: int = int(max_folds)
        self._handles = handles
        self._options = plan
        self._plans: dict[tuple[int, int], Plan] = {}

    def __getstate__(self) -> dict[str, Any]:
        kept = ("sigma", "grid", "max_folds", "_handles", "_options")
        return {name: self.__dict__[name] for name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _plans={})

    def plan(self, size: tuple[int, int]) -> Plan:
        """The handles at rest on images of this width and height; the last ones are kept."""
        size = (int(size[0]), int(size[1]))
        # Without a lock, which a forked worker would inherit closed: two threads may make the same.
        plan = self._plans.get(size)
        if plan is None:
            plan = self._plans[size] = Plan(self._rest(size), size=size, **self._options)
            while len(self._plans) > _KEPT_PLANS:
                with suppress(KeyError, RuntimeError, StopIteration):
                    del self._plans[next(iter(self._plans))]
        return plan

    def _rest(self, size: tuple[int, int]) -> Handles:
        if self._handles is not None:
            return self._handles
        sides = [np.linspace(0, side, count) for side, count in zip(size, self.grid, strict=True)]
        return np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)

    def sample(self, rng: np.random.Generator, size: tuple[int, int]) -> Pose:
        """A warp of images of this width and height; the same state of `rng` gives the same."""
        plan = self.plan(size)
        seed = int(rng.integers(2**63))
        for attempt in range(_MOST_ATTEMPTS):
            [pose] = plan.jitter(sigma=self.sigma / 2**attempt, count=1, seed=seed)
            if pose.folds <= self.max_folds:
                return pose
        return plan.pose(plan.p)
