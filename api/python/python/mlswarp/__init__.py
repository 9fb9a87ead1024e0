"""Warps images with control handles: moving least squares (Schaefer, McPhail, Warren 2006),
thin-plate splines, field morphing.

>>> import numpy as np
>>> import mlswarp
>>> image = np.zeros((300, 451, 3), np.uint8)
>>> plan = mlswarp.Plan([[168, 112], [316, 136], [262, 240]], like=image)
>>> pose = plan.pose([[168, 112], [316, 136], [262, 270]])
>>> pose.warp(image).shape
(300, 451, 3)
>>> pose.points([[262, 240]]).round(6)
array([[262., 270.]])
"""

from importlib.metadata import version as _version
from typing import TYPE_CHECKING, Any

from ._blend import Blended, blend, blend_frames
from ._engine import num_threads as get_num_threads
from ._engine import set_num_threads
from ._files import File, Landmarks, load_landmarks, warp_file
from ._plan import Candidate, FitReport, Plan
from ._pose import Canvas, Fill, Pose, Report
from ._values import (
    Coordinates,
    Handles,
    Image,
    ImageArray,
    from_centers,
    to_centers,
)
from .errors import (
    ApiError,
    AuthenticationError,
    BadImage,
    BadLandmarks,
    ConnectionFailed,
    FoldedError,
    InternalError,
    InvalidWarp,
    MlswarpError,
    Overloaded,
    PermissionDenied,
    RateLimited,
    RequestTimeout,
    SessionExpired,
    SessionNotFound,
    Superseded,
    TooLarge,
    UnsupportedArray,
)

if TYPE_CHECKING:
    from .client import AsyncClient, Client

__version__: str = _version("mlswarp")


def __getattr__(name: str) -> Any:
    # Their dependencies are an extra.
    if name in ("AsyncClient", "Client"):
        from . import client

        return getattr(client, name)
    raise AttributeError(f"module 'mlswarp' has no attribute {name!r}")


__all__ = [
    "ApiError",
    "AsyncClient",
    "AuthenticationError",
    "BadImage",
    "BadLandmarks",
    "Blended",
    "Candidate",
    "Canvas",
    "Client",
    "ConnectionFailed",
    "Coordinates",
    "File",
    "Fill",
    "FitReport",
    "FoldedError",
    "Handles",
    "Image",
    "ImageArray",
    "InternalError",
    "InvalidWarp",
    "Landmarks",
    "MlswarpError",
    "Overloaded",
    "PermissionDenied",
    "Plan",
    "Pose",
    "RateLimited",
    "Report",
    "RequestTimeout",
    "SessionExpired",
    "SessionNotFound",
    "Superseded",
    "TooLarge",
    "UnsupportedArray",
    "blend",
    "blend_frames",
    "from_centers",
    "get_num_threads",
    "load_landmarks",
    "set_num_threads",
    "to_centers",
    "warp_file",
]
