"""Masks: what is read, scaled and refused. Depth maps: their numbers at a photograph's points."""

from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
import torch

from dgc_pose.errors import InputError
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.decoding import Exif
from dgc_pose.images.depth import read_depth
from dgc_pose.images.image import Image, flipped, load_image, masked, turned

USED = np.random.default_rng(0).random((40, 60)) < 0.6
IMAGE = Image(np.random.default_rng(1).integers(0, 256, (40, 60, 3), np.uint8))


def _mask(source: object) -> np.ndarray:
    image = masked(IMAGE, source, "mask1")  # type: ignore[arg-type]
    assert image.mask is not None and image.mask.dtype == bool
    used = image.mask
    assert np.array_equal(image.pixels[used], IMAGE.pixels[used])
    mean = IMAGE.pixels[used].mean(0)
    assert np.abs(image.pixels[~used] - mean).max(initial=0) < 1
    return used


def test_black_and_alpha_0_are_ignored(tmp_path: Path) -> None:
    """In 16 bit, one bit, colours of which only one is not 0, and under alpha of white."""
    blue = np.zeros((40, 60, 3), np.uint8)
    blue[USED, 0] = 1
    white = np.full((40, 60, 1), 255, np.uint8)
    alpha = USED[..., None] * np.uint8(9)
    cut_out = np.dstack([white, white, white, alpha])
    for pixels in (USED * np.uint16(700), blue, cut_out):
        assert cv2.imwrite(str(tmp_path / "mask.png"), pixels)
        assert np.array_equal(_mask(tmp_path / "mask.png"), USED)
    PIL.Image.fromarray(USED).save(tmp_path / "bit.png")
    grey = np.dstack([white, alpha])
    for source in (
        str(tmp_path / "bit.png"),
        USED * 0.5,
        USED.tolist(),
        torch.from_numpy(USED),
        grey,
    ):
        assert np.array_equal(_mask(source), USED)
    assert masked(IMAGE, None) is IMAGE


def test_a_mask_is_joined_with_that_of_the_image() -> None:
    left = np.broadcast_to(np.arange(60) < 30, (40, 60))
    image = masked(load_image(np.dstack([IMAGE.pixels, 255 * USED])), left)
    assert image.mask is not None and np.array_equal(image.mask, USED & left)
    mean = IMAGE.pixels[USED & left].mean(0)
    assert np.abs(image.pixels[~image.mask] - mean).max() < 1
    with pytest.raises(InputError, match="mask1 leaves no pixel of the image"):
        masked(image, ~left, "mask1")


def test_a_mask_of_another_size_is_scaled() -> None:
    """If its aspect ratio is the same within one per cent."""
    assert np.array_equal(_mask(USED.repeat(2, 0).repeat(2, 1)), USED)
    small = USED[::4, ::4]
    assert np.array_equal(_mask(small), small.repeat(4, 0).repeat(4, 1))
    half = np.arange(604)[None] < np.full((400, 1), 302)
    assert np.array_equal(_mask(half), np.arange(60)[None] < np.full((40, 1), 30))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (np.zeros((40, 60)), "mask1 leaves no pixel of the image"),
        (USED[::3, ::3][:13, :20], "mask1 is 20 x 13 and the image 60 x 40"),  # 2.6 per cent off
        (np.ones(60), r"mask1 must have shape \(H, W\), not \(60,\)"),
        ([["a"]], "mask1 is not an array of real numbers"),
    ],
)
def test_a_mask_that_does_not_fit_the_image_is_refused(source: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        _mask(source)


def test_points_on_masked_pixels() -> None:
    """A pixel reaches half a pixel around its centre. Nothing outside the image is masked."""
    image = masked(IMAGE, USED)
    points = np.random.default_rng(2).uniform(-3, 63, (50, 20, 2))
    points[0, :2] = (np.nan, 3), (np.inf, 1e12)
    inside = ((points >= -0.5) & (points < (59.5, 39.5))).all(-1)
    x, y = np.where(inside[..., None], np.nan_to_num(points) + 0.5, 0).astype(int).T
    assert np.array_equal(image.is_masked(points), inside & ~USED[y, x].T) and 100 < inside.sum()
    assert not IMAGE.is_masked(points).any()


@pytest.mark.parametrize("orientation", [1, 4, 6, 7])
def test_a_mask_is_turned_with_its_pixels(orientation: int) -> None:
    """A mask is of the pixels as stored; a mirror image has both mirrored."""
    stored = np.dstack([USED * np.uint8(255), *np.indices(USED.shape).astype(np.uint8)])
    upright = np.ascontiguousarray(turned(stored, orientation))
    image = masked(Image(upright, exif=Exif(orientation=orientation)), USED)
    for shown in (image, flipped(image, 0), flipped(image, 1)):
        assert shown.mask is not None and shown.pixels.flags.c_contiguous
        left_out = shown.pixels[~shown.mask]
        assert (shown.pixels[shown.mask][:, 0] == 255).all() and (left_out == left_out[0]).all()


def depth_at(inverse: np.ndarray | None, points: np.ndarray) -> np.ndarray:
    """Depths (N,) at points (N, 2) of the photograph."""
    assert inverse is not None
    return 1 / bilinear_at(inverse, *points.T[:, :, None])[:, 0]


def plane(width: int, height: int) -> np.ndarray:
    """Depths (h, w), metres, of a slanted plane: the inverse is linear over the image's sides."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return 1 / (0.3 + 0.1 * x + 0.05 * y)


@pytest.mark.parametrize("size", [(80, 60), (403, 302)])
def test_a_map_of_another_size_has_the_depths_of_the_plane(size: tuple[int, int]) -> None:
    depth = read_depth(plane(160, 120), "depth1", size, 1)
    points = np.random.default_rng(0).uniform(0.1, 0.9, (50, 2))
    expected = 1 / (0.3 + points @ (0.1, 0.05))
    np.testing.assert_allclose(depth_at(depth, points * size - 0.5), expected, rtol=1e-4)


@pytest.mark.parametrize("hole", [0, -1, np.nan])
def test_holes_and_edges_have_no_depth_and_integers_are_millimetres(hole: float) -> None:
    stored = np.full((60, 80), 2.0)
    stored[:, 40:] = 3.0
    stored[10:20, 10:20] = hole
    depth = read_depth(stored, "depth1", (80, 60), 1)
    points = np.array([[5.0, 5.0], [15.0, 15.0], [39.6, 30.0], [50.0, 30.0]])
    np.testing.assert_allclose(depth_at(depth, points), [2, np.nan, np.nan, 3], rtol=1e-6)
    for kind in (np.uint16, np.int32):
        depth = read_depth(np.full((60, 80), 1234, kind), "depth1", (80, 60), 1)
        np.testing.assert_allclose(depth_at(depth, points), 1.234, rtol=1e-6)


@pytest.mark.parametrize("orientation", [2, 6, 7])
def test_a_map_is_turned_as_its_photograph(orientation: int) -> None:
    stored = plane(80, 60).astype(np.float32)
    image = PIL.Image.fromarray(stored)
    image.getexif()[274] = orientation
    upright = np.asarray(PIL.ImageOps.exif_transpose(image))
    size = upright.shape[1], upright.shape[0]
    depth = read_depth(stored, "depth1", size, orientation)
    np.testing.assert_allclose(
        depth_at(depth, np.array([[20.0, 11.0]])), upright[11, 20], rtol=1e-4
    )
