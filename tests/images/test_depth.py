"""Depth maps: their numbers at points of photographs of other sizes and orientations."""

import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest

from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.depth import read_depth


def depth_at(inverse: np.ndarray | None, points: np.ndarray) -> np.ndarray:
    """Depths (N,) at points (N, 2) of the photograph."""
    assert inverse is not None
    return 1 / bilinear_at(inverse, *points.T[:, :, None])[:, 0]


def plane(width: int, height: int) -> np.ndarray:
    """Depths (h, w), metres, of a slanted plane: the inverse is linear over the image's sides."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return 1 / (0.3 + 0.1 * x + 0.05 * y)


@pytest.mark.parametrize("size", [(80, 60), (160, 120), (640, 480), (403, 302)])
def test_a_map_of_another_size_has_the_depths_of_the_plane(size: tuple[int, int]) -> None:
    depth = read_depth(plane(160, 120), "depth1", size, 1)
    points = np.random.default_rng(0).uniform(0.1, 0.9, (50, 2))
    expected = 1 / (0.3 + points @ (0.1, 0.05))
    np.testing.assert_allclose(depth_at(depth, points * size - 0.5), expected, rtol=1e-4)


@pytest.mark.parametrize("hole", [0, -1, np.nan, np.inf])
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


@pytest.mark.parametrize("orientation", range(1, 9))
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
