"""Altered pairs against a point of their scene, a white spot in both images; and pasted ones."""

import gzip

import cv2
import numpy as np
import pytest
from scenes import two_view_scene

from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.benchmarks.probability.planned import ALTERATIONS, altered, planned
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


def test_a_pasted_pair_keeps_a_part_of_image_2_and_has_no_pose(tmp_path):
    """Around it image 2 shows itself mirrored, or another pair's image 1."""
    rng, size = np.random.default_rng(0), (120, 90)
    for name in "abcd":
        pixels = cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), size)
        cv2.imwrite(str(tmp_path / f"{name}.png"), pixels)
    K, pose = "100 0 60 0 100 45 0 0 1", "1 0 0 0.1 0 1 0 0 0 0 1 0 0 0 0 1"
    lines = [f"{a}.png {b}.png 0 0 {K} {K} {pose}\n" for a, b in ("ab", "cd")]
    with gzip.open(tmp_path / "p.txt.gz", "wt", encoding="utf-8") as file:
        file.writelines(lines)
    entry = PlanEntry("p", "fit", "pasted", seed=3)
    for number, pair in enumerate(planned(entry, tmp_path, tmp_path)):
        made, again = pair.make(), pair.make()
        assert made.truth.R is None and made.truth.t is None and pair.scene == "p"
        second = cv2.imread(str(tmp_path / f"{'bd'[number]}.png"))[..., ::-1]
        kept = (made.image2.pixels == second).all(-1)
        assert made.image2.size == size and 0.05 < kept.mean() < 0.7
        corners = kept[[0, 0, -1, -1], [0, -1, 0, -1]]
        assert not corners.any()
        np.testing.assert_array_equal(made.image2.pixels, again.image2.pixels)


@pytest.mark.parametrize("number", range(4))
def test_a_zoomed_pair_has_the_cameras_of_its_images(tmp_path, number):
    """Both are of a longer lens; of every fourth pair image 2 alone is zoomed."""
    size, K = (120, 90), np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]])
    spots = np.array([[66.0, 50.0], [54.0, 41.0]])
    for name, spot in zip("ab", spots, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), _spot(spot, size).pixels)
    numbers = " ".join(map(str, K.ravel()))
    line = f"a.png b.png 0 0 {numbers} {numbers} 1 0 0 0.1 0 1 0 0 0 0 1 0 0 0 0 1\n"
    with gzip.open(tmp_path / "z.txt.gz", "wt", encoding="utf-8") as file:
        file.writelines(4 * [line])
    pair = planned(PlanEntry("z", "fit", "zoomed", seed=5), tmp_path, tmp_path)[number]
    made, again = pair.make(), pair.make()
    np.testing.assert_array_equal(made.image2.pixels, again.image2.pixels)
    np.testing.assert_allclose(made.truth.t, (0.1, 0, 0))
    factors = []
    for image, camera, spot in zip(
        (made.image1, made.image2), (made.truth.camera1, made.truth.camera2), spots, strict=True
    ):
        assert image.size == camera.size == size
        factors.append(camera.K[0, 0] / 100)
        y, x = np.nonzero(image.pixels[..., 0] > 128)
        ray = (spot - K[:2, 2]) / 100
        seen = camera.normalise(np.array([[x.mean(), y.mean()]]))[0]
        np.testing.assert_allclose(seen, ray, atol=0.6 / camera.K[0, 0])
    if number == 0:
        assert factors[0] == 1 and 1.09 < factors[1] < 1.62
    else:
        assert 1.38 < factors[0] < 3.05 and factors[0] == pytest.approx(factors[1], rel=0.03)
