"""Altered pairs against a point of their scene, a white spot in both images."""

import numpy as np
import pytest
from scenes import two_view_scene

from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.probability.planned import ALTERATIONS, altered
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.images.image import Image

SCENE = two_view_scene("skew", count=5, outliers=0.0, sigma_px=0.0)


def _spot(points: np.ndarray, size: tuple[int, int]) -> Image:
    x, y = np.rint(points).astype(int)
    pixels = np.zeros((size[1], size[0], 3), np.uint8)
    pixels[y - 2 : y + 3, x - 2 : x + 3] = 255
    return Image(pixels)


@pytest.mark.parametrize("way", ALTERATIONS)
@pytest.mark.parametrize("number", range(5))
def test_the_truth_is_that_of_the_altered_images(way, number):
    camera1, camera2 = SCENE.cameras
    images = [
        _spot(points[number], camera.size)
        for points, camera in ((SCENE.points1, camera1), (SCENE.points2, camera2))
    ]
    pair = altered(PosedPair(Truth({}, camera1, camera2, SCENE.R, SCENE.t), *images), way)
    truth, rays = pair.truth, []
    for image, camera in ((pair.image1, truth.camera1), (pair.image2, truth.camera2)):
        assert camera.size == image.size
        y, x = np.nonzero(image.pixels[..., 0] > 200)
        rays.append(camera.normalise(np.array([[x.mean(), y.mean()]])))
    E = essential_from_pose(truth.R, truth.t)
    assert sampson_distance(*rays, E)[0] * truth.camera1.focal < 1
    assert way == "darkened" or any(
        not np.array_equal(ours.pixels, image.pixels)
        for ours, image in zip((pair.image1, pair.image2), images, strict=True)
    )
