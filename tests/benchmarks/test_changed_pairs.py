"""Rolled, shrunk and cropped views: their cameras and poses say where the pixels went."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.changed_pairs import ChangedPairs, ImageChange, changed_view
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.images.image import Image

SIZE = (200, 140)
K = np.array([[180.0, 0, 96.0], [0, 176.0, 73.0], [0, 0, 1]])
SPOTS = np.array([[80.0, 60.0], [120.0, 55.0], [95.0, 85.0]])  # pixels


def _spots() -> Image:
    """Soft spots, each in a colour of its own."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    planes = [255 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 18) for u, v in SPOTS]
    return Image(np.dstack(planes).round().astype(np.uint8))


@pytest.mark.parametrize(
    "angle, shrink, crop",
    [(0, 1, 1), (37, 1, 1), (-120, 1, 1), (90, 1, 1), (0, 2.5, 1), (0, 1, 2), (200, 2, 1.5)],
)
def test_rays_meet_the_pixels_that_they_met_before(
    angle: float, shrink: float, crop: float
) -> None:
    image, camera, turn = changed_view(_spots(), Camera(K, SIZE), angle, shrink, crop)
    assert camera.size == image.size
    rays = np.linalg.inv(K) @ np.column_stack([SPOTS, np.ones(3)]).T
    expected = (camera.K @ turn @ rays)[:2].T  # the turn leaves depth as it is
    y, x = np.mgrid[: image.size[1], : image.size[0]]
    for plane, point in enumerate(expected):
        weights = image.pixels[..., plane].astype(float)
        found = np.array([(weights * x).sum(), (weights * y).sum()]) / weights.sum()
        np.testing.assert_allclose(found, point, atol=0.35)
    if crop == 1:
        area = shrink**2 * np.count_nonzero(image.pixels.any(2))
        assert area == pytest.approx(np.count_nonzero(_spots().pixels.any(2)), rel=0.2)


def _pair(folder: Path) -> Pair:
    for name, shift in (("1.png", 0), ("2.png", 4)):
        pixels = np.roll(_spots().pixels, shift, 1)
        assert cv2.imwrite(str(folder / name), pixels)
    R = Rotation.from_euler("xyz", [5, -8, 3], degrees=True).as_matrix()
    camera = Camera(K, SIZE)
    return Pair("1.png", "2.png", folder, camera, camera, R, np.array([1.0, 0.2, 0.1]))


def test_pairs_are_changed_in_image_2_alone(tmp_path: Path) -> None:
    pair = _pair(tmp_path)
    pairs = ChangedPairs([pair], ImageChange(roll=30.0, shrink=2.0))
    (found,) = pairs.read()
    assert found.image1.size == SIZE and found.truth.camera1.K is pair.camera1.K
    assert pairs.ids == [{"image1": "1.png", "image2": "2.png roll 30.0 / 2 x 1"}]
    turn = Rotation.from_euler("z", -30, degrees=True).as_matrix()  # y points down
    np.testing.assert_allclose(found.truth.R, turn @ pair.R, atol=1e-12)
    np.testing.assert_allclose(found.truth.t, turn @ pair.t, atol=1e-12)
    assert found.image2.size == (122, 111)  # of 100 x 70 rolled by 30 degrees


def test_rolls_at_random_are_the_same_again_and_never_small(tmp_path: Path) -> None:
    pairs = [_pair(tmp_path)] * 50
    angles, again = (ChangedPairs(pairs, ImageChange(roll_at_random=True)).angles for _ in "12")
    assert angles == again and len(set(angles)) == 50 and min(angles) >= 30 and max(angles) <= 330
