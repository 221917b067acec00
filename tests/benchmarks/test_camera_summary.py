"""The figures of focal lengths and claims, of records made by hand."""

import math

import pytest

from dgc_pose.benchmarks.camera_summary import camera_table, summarise_cameras
from dgc_pose.benchmarks.scores import CameraScore


def score(rotation, focal, std, probability, *, doubts=False):
    success = math.isfinite(rotation)
    return CameraScore(
        method="m",
        image1="a",
        image2="b",
        true_rotation_deg=10.0,
        status="ok" if success else "improbable",
        success=success,
        num_matches=10,
        num_inliers=8,
        inlier_ratio=0.8,
        rotation_error_deg=rotation,
        translation_error_deg=rotation,
        translation_folded_deg=rotation,
        match_seconds=0.5,
        estimate_seconds=0.25,
        rotation_90_deg=1.0 if success else math.nan,
        translation_90_deg=3.0 if success else math.nan,
        probability=probability,
        focal1_error=math.log(focal) if success else math.nan,
        focal2_error=math.log(focal) if success else math.nan,
        focal1_std=std if success else math.nan,
        focal2_std=std if success else math.nan,
        focal_ratio=math.nan,
        focal_ratio_std=math.nan,
        doubts_camera=doubts,
    )


def test_the_figures_of_known_records():
    summary = summarise_cameras(
        [
            score(0.5, 1.01, 0.01, 0.9),
            score(2.0, 0.98, 0.005, 0.9),  # four deviations off
            score(4.0, 1.2, 0.3, 0.9, doubts=True),
            score(12.0, 0.5, 0.3, 0.9),  # wrong, and over two deviations off
            score(math.inf, math.nan, math.nan, 0.2),
        ]
    )
    assert (summary.pairs, summary.failures, summary.claimed, summary.wrong) == (5, 1, 4, 1)
    assert summary.doubted == 1 and summary.told_percent == 40
    # Of three right poses one is within 1 degree in R and two within 3 degrees in t.
    assert summary.rotation_within_percent == pytest.approx(100 / 3)
    assert summary.translation_within_percent == pytest.approx(200 / 3)
    # Focal lengths 1, 2, 20 and 50 % off, each of two cameras.
    assert summary.median_focal_error_percent == pytest.approx(11)
    assert summary.focal_within_percent == 50
    assert (summary.sure_percent, summary.sure_focal_within_percent) == (50, 50)
    assert summary.sure_median_focal_error_percent == pytest.approx(1.5)
    # 4 x 0.9 expected to be right where 3 are; one of 0.2 where none is.
    assert summary.probability_error_percent == pytest.approx(100 * (0.6 + 0.2) / 5)


def test_no_pose_has_no_figures_and_no_word_of_them():
    summary = summarise_cameras([score(math.inf, math.nan, math.nan, 0.0)])
    assert (summary.claimed, summary.wrong, summary.told_percent) == (0, 0, 100)
    assert math.isnan(summary.median_focal_error_percent)
    line = camera_table([summary]).splitlines()[-1]
    assert line.split() == "m 0 0 0 100.0 - - - - - - - -".split()
