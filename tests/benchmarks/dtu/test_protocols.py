"""What the protocols show of a pair: image sizes, cameras, options."""

from __future__ import annotations

from dataclasses import replace

import cv2
import dense_scene
import dtu_entries
import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.epipolar import median_and_mean, true_fundamental
from dgc_pose.benchmarks.dtu.protocols import (
    PairReader,
    estimation_options,
    matching_options,
)
from dgc_pose.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matching import MatchingOptions


def test_paper_squares_the_images_and_the_cameras(tmp_path) -> None:
    """A point that both cameras see lands at the same place of the scene: true matches stay true,
    their distances from the epipolar lines being zero after the resize as before."""
    (entry,) = dtu_entries.entries(tmp_path, 1)
    found = dense_scene.true_map()
    for protocol in ("paper", "native"):
        shown = PairReader(protocol).read(entry.scene, entry.view1, entry.view2, entry.pair)
        size = (256, 256) if protocol == "paper" else dense_scene.SIZE
        assert shown.image1.size == shown.image2.size == size
        assert shown.truth.camera1.size == shown.truth.camera2.size == size
        assert (shown.size1, shown.size2) == (dense_scene.SIZE, dense_scene.SIZE)
        scale = np.divide(size, dense_scene.SIZE)
        points1, points2 = ((p + 0.5) * scale - 0.5 for p in (found.map, found.grid))
        median, mean = median_and_mean(points1, points2, true_fundamental(shown.truth))
        assert max(median, mean) < 1e-3
        assert (shown.image1.name, shown.truth.name1) == (str(tmp_path / "one.png"), "one.png")
    original = cv2.imread(str(tmp_path / "two.png"))[..., ::-1]
    assert np.array_equal(shown.image2.pixels, original)


def test_an_image_is_read_once(tmp_path) -> None:
    one, two = dtu_entries.entries(tmp_path, 2)
    reader = PairReader("paper")
    first = reader.read(one.scene, one.view1, one.view2, one.pair)
    (tmp_path / "one.png").unlink()
    second = reader.read(two.scene, two.view1, two.view2, two.pair)
    assert second.image1 is first.image1 and second.image2 is first.image2


def test_a_camera_of_another_size_is_refused(tmp_path) -> None:
    (entry,) = dtu_entries.entries(tmp_path, 1)
    wrong = replace(entry.pair, camera2=Camera(dense_scene.K, (640, 480)))
    with pytest.raises(InputError, match="two.png is for an image of 640 x 480"):
        PairReader("native").read(65, 1, 2, wrong)


def test_paper_takes_every_match_and_does_not_refine() -> None:
    estimation, matching = EstimationOptions(seed=3), MatchingOptions(matchability=0.4)
    assert estimation_options("paper", estimation) == replace(estimation, refine=False)
    assert estimation_options("native", estimation) == estimation
    assert matching_options("native", matching) == matching
    every = matching_options("paper", matching)
    assert every.matchability == 0.4 and every.max_matches > 256 * 256


def test_epipolar_figures_are_those_of_the_equation() -> None:
    """Against the distances of points and lines, one by one, and in the presence of infinities."""
    rng = np.random.default_rng(0)
    F = rng.standard_normal((3, 3))
    points1, points2 = rng.uniform(0, 100, (2, 25, 2))
    expected = []
    for (x1, y1), (x2, y2) in zip(points1, points2, strict=True):
        a, b, c = F @ [x1, y1, 1]
        d, e, f = F.T @ [x2, y2, 1]
        to_line2 = abs(a * x2 + b * y2 + c) / np.hypot(a, b)
        to_line1 = abs(d * x1 + e * y1 + f) / np.hypot(d, e)
        expected.append((to_line1 + to_line2) / 2)
    found = median_and_mean(points1.reshape(5, 5, 2), points2.reshape(5, 5, 2), F)
    assert found == pytest.approx((np.median(expected), np.mean(expected)))
    points1[:3] = np.inf
    median, mean = median_and_mean(points1, points2, F)
    assert median == pytest.approx(np.sort([np.inf] * 3 + expected[3:])[12]) and mean == np.inf
    assert median_and_mean(np.zeros((0, 2)), np.zeros((0, 2)), F) == (np.inf, np.inf)
