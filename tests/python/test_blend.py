"""Blends: laws, and the same pixels as the service."""

import io
import json
import zipfile

import mlswarp
import numpy as np
import pytest
from PIL import Image

FIRST = np.array([[12.0, 10], [50, 12], [31, 24], [15, 38], [47, 38]])
SECOND = FIRST + [[3, -2], [-4, 2], [2, 5], [0, -3], [-1, 2]]


def waves(seed, channels=3, dtype=np.uint8):
    """A smooth picture."""
    y, x = np.mgrid[0:48, 0:64]
    of = [0.5 + 0.4 * np.sin(x / (3 + c + seed) + y / (5 + seed - c)) for c in range(channels)]
    return (np.stack(of, 2) * np.iinfo(dtype).max).round().astype(dtype)


def png(array):
    file = io.BytesIO()
    Image.fromarray(array).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_one_image_is_itself_and_equal_ones_too(dtype):
    image = waves(1, dtype=dtype)
    alone = mlswarp.blend([image], [FIRST])
    np.testing.assert_array_equal(alone.image, image)
    assert alone.image.dtype == dtype and alone.clamped == 0 and alone.folds == (0,)
    frames = list(mlswarp.blend_frames([image, image], [FIRST, FIRST], steps=3))
    assert all(np.abs(frame.image.astype(int) - image).max() <= 1 for frame in frames)
    np.testing.assert_allclose(frames[1].landmarks, FIRST)


def test_shape_and_colours_have_shares_of_their_own():
    dark, light = np.full((48, 64, 3), 40, np.uint8), np.full((48, 64, 3), 200, np.uint8)
    mean = mlswarp.blend([dark, light], [FIRST, SECOND], align="none")
    np.testing.assert_allclose(mean.landmarks, (FIRST + SECOND) / 2)
    # At the rim neither image covers the result, so it has alpha.
    middle = (slice(20, 30), slice(20, 40), slice(3))
    assert mean.image.shape == (48, 64, 4) and (mean.image[middle] == 120).all()
    shape = mlswarp.blend(
        [dark, light], [FIRST, SECOND], shape=[0.5, 0.5], colour=[1, 0], align="none"
    )
    assert shape.landmarks == mean.landmarks and (shape.image[middle] == 40).all()
    caricature = mlswarp.blend(
        [dark, light], [FIRST, SECOND], shape=[1.5, -0.5], colour=[1.5, -0.5], align="none"
    )
    np.testing.assert_allclose(caricature.landmarks, 1.5 * FIRST - 0.5 * SECOND)
    assert caricature.clamped > 0


def test_a_face_and_its_mirror_image_are_symmetric():
    found = mlswarp.blend([waves(2)], [FIRST], mirror=True, pairs=[1, 0, 2, 4, 3]).image
    inner = (slice(14, 34), slice(16, 48))
    differences = np.abs(found.astype(int) - found[:, ::-1])[inner]
    assert differences.max() <= 1


def test_it_is_what_the_service_draws(server):
    images = [waves(1), waves(4)]
    entries = [
        {"image": k, "p": p, "shape": shape, "colour": colour}
        for k, (p, shape, colour) in enumerate(((FIRST, 0.3, 0.6), (SECOND, 0.7, 0.4)))
    ]
    options = {"method": "similarity", "alpha": 1.5, "align": "rigid", "space": "linear"}
    here = mlswarp.blend(images, [FIRST, SECOND], shape=[0.3, 0.7], colour=[0.6, 0.4], **options)
    with mlswarp.Client(server.address) as client:
        files = [png(image) for image in images]
        drawn = client.blend(files, {"images": entries, **options})
        there = drawn.array()
        covered = there[..., 3] == 255 if there.shape[2] == 4 else np.ones(there.shape[:2], bool)
        np.testing.assert_array_equal(here.image[..., :3][covered], there[..., :3][covered])
        # Landmarks in files, and several frames in one.
        texts = ["\n".join(f"{x},{y}" for x, y in p) for p in (FIRST, SECOND)]
        tables = [f"x,y\n{text}\n".encode() for text in texts]
        blend = {"images": [{"image": 0}, {"image": 1}], "steps": 3, "method": "affine", "alpha": 2}
        answer = client.blend(files, blend, landmarks=tables, accept="application/zip")
        archive = zipfile.ZipFile(io.BytesIO(answer.content))
        frames = list(mlswarp.blend_frames(images, [FIRST, SECOND], steps=3))
        for k, frame in enumerate(frames):
            drawn = np.asarray(Image.open(io.BytesIO(archive.read(f"{k:04}.png"))))
            covered = drawn[..., 3] == 255
            np.testing.assert_array_equal(frame.image[..., :3][covered], drawn[..., :3][covered])
            landmarks = json.loads(archive.read(f"{k:04}.json"))["p"]
            np.testing.assert_allclose(frame.landmarks, landmarks)


def test_what_is_wrong_is_said():
    image = waves(1)
    with pytest.raises(mlswarp.InvalidWarp, match="landmarks for each of 2 images; found 1"):
        mlswarp.blend([image, image], [FIRST])
    with pytest.raises(mlswarp.InvalidWarp, match="add up to 1.5"):
        mlswarp.blend([image, image], [FIRST, SECOND], shape=[1, 0.5])
    with pytest.raises(mlswarp.InvalidWarp, match="a share for each of 2 images; found 1"):
        mlswarp.blend([image, image], [FIRST, SECOND], colour=[1])
    with pytest.raises(mlswarp.InvalidWarp) as caught:
        mlswarp.blend([image, image], [FIRST, SECOND[:3]])
    assert caught.value.code == "shape_mismatch" and caught.value.pointer == "/images/1"
    with pytest.raises(mlswarp.InvalidWarp, match="use blend_frames"):
        mlswarp.blend([image, image], [FIRST, SECOND], steps=3)
