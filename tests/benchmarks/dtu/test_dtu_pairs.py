"""What the protocols show of a pair: image sizes, cameras, options."""

from dataclasses import replace

import cv2
import dense_scene
import numpy as np
from evaluation_pairs import posed_pairs

from dgc_pose.benchmarks.dtu.dtu_pairs import protocol_options
from dgc_pose.benchmarks.metrics import median_and_mean, true_fundamental
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import MatchingOptions


def test_paper_squares_the_images_and_the_cameras(tmp_path) -> None:
    """A point that both cameras see stays the same point of the scene: true matches stay true,
    their distances from the epipolar lines being zero after the resize as before."""
    found = dense_scene.true_map()
    for protocol in ("paper", "native"):
        shown = posed_pairs(tmp_path, 1, protocol).pair(0)
        truth = shown.truth
        size = (256, 256) if protocol == "paper" else dense_scene.SIZE
        assert shown.image1.size == shown.image2.size == size
        assert truth.camera1.size == truth.camera2.size == size
        for image in (shown.image1, shown.image2):
            assert (image.stored_size or image.size) == dense_scene.SIZE
        scale = np.divide(size, dense_scene.SIZE)
        points1, points2 = ((p + 0.5) * scale - 0.5 for p in (found.map, found.grid))
        F = true_fundamental(truth.camera1, truth.camera2, truth.R, truth.t)
        median, mean = median_and_mean(points1, points2, F)
        assert max(median, mean) < 1e-3
        names = (shown.image1.name, truth.ids["image1"])
        assert names == (str(tmp_path / "one.png"), "one.png")
    original = cv2.imread(str(tmp_path / "two.png"))[..., ::-1]
    assert np.array_equal(shown.image2.pixels, original)


def test_paper_takes_every_match_and_does_not_refine() -> None:
    options = MatcherOptions(matching=MatchingOptions(matchability=0.4)), EstimationOptions(seed=3)
    assert protocol_options("native", *options) == options
    paper, estimation = protocol_options("paper", *options)
    assert estimation == replace(options[1], refine=False)
    assert paper.refinement.source == "none"
    assert paper.matching.matchability == 0.4 and paper.matching.max_matches > 256 * 256
