"""The figures of planes, of records made by hand."""

import math

import pytest

from dgc_pose.benchmarks.plane_summary import PLANE_COLUMNS, summarise_planes
from dgc_pose.benchmarks.scores import PlaneScore
from dgc_pose.files.tables import table


def score(relief, status, rotation, translation, probability):
    return PlaneScore(
        method="m",
        image1="a",
        image2="b",
        relief=relief,
        probability=probability,
        true_rotation_deg=30.0,
        status=status,
        success=status == "ok",
        num_matches=10,
        num_inliers=8,
        inlier_ratio=0.8,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        translation_folded_deg=min(translation, abs(180 - translation)),
        match_seconds=0.5,
        estimate_seconds=0.25,
        epipolar_all_px=1.0,
        epipolar_confident_px=1.0,
        epipolar_all_mean_px=1.0,
        epipolar_confident_mean_px=1.0,
    )


SCORES = (
    score(0.05, "ok", 1.0, 2.0, 0.9),
    score(0.05, "ok", 1.0, 175.0, 0.7),  # wrong: t is not folded
    score(0.05, "ok", 10.0, 10.0, 0.8),
    score(0.0, "ambiguous", math.inf, math.inf, 0.0),
    score(0.0, "improbable", math.inf, math.inf, 0.1),
)


def test_the_figures_of_known_records():
    flat, high, everything = summarise_planes(SCORES)
    assert (flat.relief, flat.pairs, flat.claimed, flat.wrong, flat.ambiguous) == (0, 2, 0, 0, 1)
    assert math.isnan(flat.probability_percent) and math.isnan(flat.right_percent)
    assert (high.relief, high.pairs, high.claimed, high.wrong, high.ambiguous) == (0.05, 3, 3, 1, 0)
    assert high.probability_percent == pytest.approx(80)
    assert high.right_percent == pytest.approx(200 / 3)
    assert everything.relief is None and everything.pairs == 5 and everything.ambiguous == 1
    lines = table(PLANE_COLUMNS, [flat, high, everything]).splitlines()
    assert [line.split()[1:] for line in lines[1:]] == [
        ["0", "%", "2", "0", "0", "1", "-", "-"],
        ["5", "%", "3", "3", "1", "0", "80.0", "66.7"],
        ["all", "5", "3", "1", "1", "80.0", "66.7"],
    ]
