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

from ._engine import num_threads as get_num_threads
from ._engine import set_num_threads
from ._files import File, Landmarks, load_landmarks, warp_file
from ._plan import Candidate, Canvas, Fill, FitReport, Plan, Pose, Report
from ._values import (
    Coordinates,
    Handles,
    Image,
    ImageArray,
    from_centers,
    to_centers,
)
from .errors import (
    BadImage,
    BadLandmarks,
    FoldedError,
    InternalError,
    InvalidWarp,
    MlswarpError,
    TooLarge,
    UnsupportedArray,
)

__version__: str = _version("mlswarp")

__all__ = [
    "BadImage",
    "BadLandmarks",
    "Candidate",
    "Canvas",
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
    "Plan",
    "Pose",
    "Report",
    "TooLarge",
    "UnsupportedArray",
    "from_centers",
    "get_num_threads",
    "load_landmarks",
    "set_num_threads",
    "to_centers",
    "warp_file",
]
