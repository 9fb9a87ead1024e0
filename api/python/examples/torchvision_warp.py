"""A random warp as a transform of torchvision (v2): an image, its masks, boxes and keypoints follow
one pose. Images are tensors of bytes, so that it comes before the conversion to floats.

    v2.Compose([v2.ToImage(), MlsWarp(sigma=6), v2.ToDtype(torch.float32, scale=True)])
"""

import numpy as np
import torch
from mlswarp.augment import RandomWarp
from torchvision import tv_tensors
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional


class MlsWarp(v2.Transform):
    """`torch.manual_seed` repeats it. In workers of a data loader set MLSWARP_NUM_THREADS=1."""

    def __init__(self, sigma=8.0, **options):
        super().__init__()
        self.warps = RandomWarp(sigma, **options)

    def make_params(self, flat_inputs):
        height, width = functional.get_size(flat_inputs[0])
        seed = int(torch.randint(2**62, ()))
        return {"pose": self.warps.sample(np.random.default_rng(seed), (width, height))}

    def transform(self, inpt, params):
        pose = params["pose"]
        if isinstance(inpt, tv_tensors.BoundingBoxes):
            corners = functional.convert_bounding_box_format(inpt, new_format="XYXY")
            moved = like(pose.boxes(corners.numpy()), corners)
            return functional.convert_bounding_box_format(moved, new_format=inpt.format)
        values = inpt.numpy()
        if isinstance(inpt, tv_tensors.KeyPoints):  # whole numbers are centres of pixels
            moved = pose.points(values.reshape(-1, 2) + 0.5) - 0.5
            return like(moved.reshape(values.shape), inpt)
        if isinstance(inpt, tv_tensors.Mask):
            planes = values.reshape(-1, *values.shape[-2:])
            moved = [pose.labels(plane) for plane in planes]
            return like(np.array(moved, values.dtype).reshape(values.shape), inpt)
        return like(np.moveaxis(pose.warp(np.moveaxis(values, 0, 2)), 2, 0), inpt)


def like(values, tensor):
    moved = torch.from_numpy(np.ascontiguousarray(values)).to(tensor.dtype)
    return tv_tensors.wrap(moved, like=tensor)
