from __future__ import annotations

import math
from dataclasses import replace

import dense_scene
import numpy as np
import pytest

from dgc_pose.benchmarks.pair_list import read_pairs
from dgc_pose.benchmarks.pairs import PairResult, require_images, run, summarise
from dgc_pose.camera import Camera
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult
from dgc_pose.matching.sift import SiftMatcher

OPTIONS = EstimationOptions(runs=2, iterations=200)


class NoMatches:
    name = "none"

    def match(self, image1, image2):
        return MatchResult(Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), 1.0), None)


class Backwards:
    """The true matches with the images exchanged: a pose that is wrong by a known amount."""

    name = "backwards"

    def match(self, image1, image2):
        found = dense_scene.MapMatcher(dense_scene.true_map()).match(image1, image2).matches
        return MatchResult(replace(found, points1=found.points2, points2=found.points1), None)


@pytest.fixture
def pairs(tmp_path):
    return read_pairs(dense_scene.write_pair_list(tmp_path, pairs=2))


def test_every_method_meets_every_pair(pairs):
    methods = {"true": dense_scene.MapMatcher(dense_scene.true_map()), "none": NoMatches()}
    results = list(run(pairs, methods, OPTIONS))
    assert [result.method for result in results] == ["true", "none", "true", "none"]
    good, lost = results[:2]
    assert good.success and good.status == "ok"
    assert good.rotation_error_deg < 0.05
    assert good.translation_error_deg < 0.2
    assert good.translation_folded_deg == good.translation_error_deg
    angle = np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2))
    assert good.true_rotation_deg == pytest.approx(angle)
    assert 0 < good.num_inliers <= good.num_matches
    assert not lost.success and lost.num_matches == 0
    assert lost.rotation_error_deg == math.inf
    assert lost.translation_error_deg == lost.translation_folded_deg == math.inf


def test_a_wrong_pose_has_its_error(pairs):
    (result,) = run(pairs[:1], {"backwards": Backwards()}, OPTIONS)
    # The pose found is cam1_from_cam2: its rotation is off by twice the true one.
    assert result.success
    assert result.rotation_error_deg == pytest.approx(2 * result.true_rotation_deg, abs=0.1)
    cosine = float(dense_scene.T @ (-dense_scene.R.T @ dense_scene.T))
    assert result.translation_error_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.3)
    folded = min(result.translation_error_deg, 180 - result.translation_error_deg)
    assert result.translation_folded_deg == folded


def test_sift_finds_the_pose_of_the_pictures(pairs):
    (result,) = run(pairs[:1], {"sift": SiftMatcher()}, EstimationOptions())
    assert result.success
    assert result.rotation_error_deg < 1
    assert result.translation_error_deg < 5


def test_results_come_one_by_one(pairs):
    results = run(pairs, {"none": NoMatches()}, OPTIONS)
    assert next(results).method == "none"
    pairs[1].path1.unlink()
    with pytest.raises(ImageError):
        next(results)


def test_a_missing_image_is_known_before_the_work(pairs):
    require_images(pairs)
    pairs[1].path2.unlink()
    with pytest.raises(ImageError, match=r"two\.png"):
        require_images(pairs)


def test_the_K_of_another_image_is_refused(pairs):
    far = Camera(np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"K of .*two\.png"):
        list(run([replace(pairs[0], camera2=far)], {"none": NoMatches()}, OPTIONS))


def result(rotation, translation, method="m"):
    success = math.isfinite(rotation)
    folded = min(translation, 180 - translation) if success else math.inf
    return PairResult(
        method=method,
        image1="a",
        image2="b",
        true_rotation_deg=10.0,
        status="ok" if success else "too_few_matches",
        success=success,
        num_matches=10,
        num_inliers=8,
        inlier_ratio=0.8,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        translation_folded_deg=folded,
        match_seconds=0.5,
        estimate_seconds=0.25 if success else 0.05,
    )


def test_the_summary_of_known_errors():
    results = [result(1, 2), result(3, 178), result(4, 1), result(math.inf, math.inf)]
    summary = summarise(results)
    assert (summary.method, summary.pairs, summary.failures) == ("m", 4, 1)
    assert summary.median_rotation_deg == 3.5
    assert summary.median_translation_deg == 90.0  # between 2 and 178
    assert summary.median_translation_folded_deg == 2.0
    assert summary.seconds_per_pair == pytest.approx((3 * 0.75 + 0.55) / 4)
    # Pair errors 2, 3, 4 and infinite: the recall is 0 at 0, then 1/4, 2/4, 3/4, and stays.
    area = 2 * 0.25 / 2 + (0.25 + 0.5) / 2 + (0.5 + 0.75) / 2
    for auc, threshold in ((summary.auc5, 5), (summary.auc10, 10), (summary.auc20, 20)):
        assert auc == pytest.approx(100 * (area + (threshold - 4) * 0.75) / threshold)


def test_the_median_is_infinite_where_half_of_the_pairs_failed():
    failed = [result(math.inf, math.inf)] * 2
    assert summarise([result(1, 2), result(1, 2), *failed]).median_rotation_deg == math.inf
    assert summarise([result(1, 2)] * 3 + failed).median_rotation_deg == 1


@pytest.mark.parametrize("results", [[], [result(1, 2, "a"), result(1, 2, "b")]])
def test_a_summary_is_of_one_method(results):
    with pytest.raises(InputError):
        summarise(results)
