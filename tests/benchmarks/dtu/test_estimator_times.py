"""The comparison with plain OpenCV: both see the same matches, and both find the pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import two_view
from dgc_pose.benchmarks.dtu.estimator_times import (
    Compared,
    compare,
    comparison_table,
    opencv_pose,
)
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

OPTIONS = EstimationOptions(refine=False)


def _scene(**kwargs) -> tuple[Matches, Pair]:
    scene = two_view.two_view_scene("general", **kwargs)
    camera1, camera2 = scene.cameras
    return scene.matches, Pair("1", "2", Path(), camera1, camera2, scene.R, 200 * scene.t)


def test_opencv_finds_the_pose_of_two_cameras() -> None:
    """Two sizes, two K: normalised points and one threshold serve both."""
    matches, truth = _scene(sigma_px=0.3)
    found = opencv_pose(matches, truth, OPTIONS)
    assert found is not None
    assert rotation_error_deg(found[0], truth.R) < 0.5
    assert translation_error_deg(found[1], truth.t) < 2


def test_both_are_measured_on_all_matches() -> None:
    matches, truth = _scene(sigma_px=0.3, count=800)
    compared = compare(matches, truth, OPTIONS)
    assert compared.matches == 800
    assert compared.seconds > 0 and compared.opencv_seconds > 0
    assert compared.rotation_deg < 0.3 and compared.opencv_rotation_deg < 0.5


def test_too_few_matches_are_no_pose_of_either() -> None:
    matches, truth = _scene()
    few = Matches(matches.points1[:4], matches.points2[:4], matches.confidence[:4], 0.5)
    compared = compare(few, truth, OPTIONS)
    assert np.isinf([compared.rotation_deg, compared.opencv_rotation_deg]).all()


def test_the_table_has_the_ratio_of_the_means() -> None:
    rows = [Compared(100, 1.0, 2.0, 3.0, 8.0, 4.0, 5.0), Compared(300, 3.0, 4.0, np.inf, 8.0, 6, 7)]
    _, ours, theirs = comparison_table([("net", rows)], "poselib").splitlines()
    assert ours.split() == ["net", "200", "poselib", "2.000", "3.00", "inf", "0.250"]
    assert theirs.split() == ["net", "200", "findEssentialMat", "8.000", "5.00", "6.00", "1"]
