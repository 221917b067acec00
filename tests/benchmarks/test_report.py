"""Figures of methods: against cases done by hand, and loops over single matches."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from dgc_pose.benchmarks.report import (
    calibration_error,
    columns,
    finite_data,
    reliability,
    shares,
    summarise,
    summary_table,
)


def score(rotation, translation, *, focal=1.0, std=0.0, probability=math.nan, doubts=False):
    success = math.isfinite(rotation)

    def known(value):
        return value if success else math.nan

    return dict(
        method="m",
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
        translation_folded_deg=min(translation, 180 - translation) if success else math.inf,
        match_seconds=0.5,
        estimate_seconds=0.25 if success else 0.05,
        rotation_90_deg=known(1.0),
        translation_90_deg=known(3.0),
        probability=probability,
        focal1_error=known(math.log(focal)),
        focal2_error=known(math.log(focal)),
        focal1_std=known(std),
        focal2_std=known(std),
        doubts_camera=doubts,
        epipolar_all_px=math.nan,
        epipolar_confident_px=rotation,
        epipolar_all_mean_px=math.nan,
        epipolar_confident_mean_px=1.0,
    )


LOST = score(math.inf, math.inf, probability=0.0)


def summary(*scores):
    ((method, column),) = columns(scores).items()
    return SimpleNamespace(**summarise(method, column))


def test_the_summary_of_known_errors():
    found = summary(score(1, 2), score(3, 178), score(4, 1), LOST)
    assert (found.method, found.pairs, found.failures) == ("m", 4, 1)
    assert found.median_rotation_deg == found.median_epipolar_confident_px == 3.5
    assert found.median_translation_deg == 90.0  # between 2 and 178
    assert found.median_translation_folded_deg == 2.0
    assert (found.matches_per_pair, found.pose_seconds_per_pair) == (10, pytest.approx(0.2))
    assert found.seconds_per_pair == pytest.approx((3 * 0.75 + 0.55) / 4)
    # Pair errors 2, 3, 4 and infinite: the recall is 0 at 0, then 1/4, 2/4, 3/4, and stays.
    area = 2 * 0.25 / 2 + (0.25 + 0.5) / 2 + (0.5 + 0.75) / 2
    for auc, threshold in ((found.auc5, 5), (found.auc10, 10), (found.auc20, 20)):
        assert auc == pytest.approx(100 * (area + (threshold - 4) * 0.75) / threshold)
    line = summary_table([vars(found)]).splitlines()[-1].split()
    assert line[:6] == ["m", "4", "1", "3.50", "90.00", "2.00"]


def test_the_figures_of_cameras_and_probabilities():
    found = summary(
        score(0.5, 0.5, focal=1.01, std=0.01, probability=0.9),
        score(2.0, 2.0, focal=0.98, std=0.005, probability=0.9),  # four deviations off
        score(4.0, 4.0, focal=1.2, std=0.3, probability=0.9, doubts=True),
        score(12.0, 12.0, focal=0.5, std=0.3, probability=0.9),  # wrong, over two deviations off
        score(math.inf, math.inf, probability=0.2),
    )
    assert (found.pairs, found.failures, found.claimed, found.wrong) == (5, 1, 4, 1)
    assert found.doubted == 1 and found.told_percent == 40
    # Of three right poses one is within 1 degree in R and two within 3 degrees in t.
    assert found.rotation_within_percent == pytest.approx(100 / 3)
    assert found.translation_within_percent == pytest.approx(200 / 3)
    # Focal lengths 1, 2, 20 and 50 % off, each of two cameras.
    assert found.median_focal_error_percent == pytest.approx(11)
    assert found.focal_within_percent == 50
    assert (found.sure_percent, found.sure_focal_within_percent) == (50, 50)
    assert found.sure_median_focal_error_percent == pytest.approx(1.5)
    # 4 x 0.9 expected to be right where 3 are; one of 0.2 where none is.
    assert found.probability_error_percent == pytest.approx(100 * (0.6 + 0.2) / 5)
    found = summary(LOST)  # which has no figures, in JSON null
    assert (found.claimed, found.wrong, found.told_percent) == (0, 0, 100)
    data = json.loads(json.dumps(finite_data(vars(found)), allow_nan=False))
    assert data["median_rotation_deg"] is data["median_focal_error_percent"] is None
    assert data["pairs"] == data["failures"] == 1


def test_every_bin_counts_its_own_matches_parts_add_up_and_empty_ones_say_nothing() -> None:
    rng = np.random.default_rng(5)
    confidence = rng.random((20, 30)).astype(np.float32)
    matches = confidence, rng.random((20, 30)) < confidence**2
    found, rest = (
        reliability(*(array[rows] for array in matches), bins=7)
        for rows in (slice(4), slice(4, None))
    )
    found += rest
    counts, correct, sums = [0] * 7, [0] * 7, [0.0] * 7
    for value, right in zip(matches[0].ravel().tolist(), matches[1].ravel().tolist(), strict=True):
        b = next(b for b in range(7) if value * 7 < b + 1)
        counts[b] += 1
        correct[b] += right
        sums[b] += value
    assert found[:2].tolist() == [counts, correct]
    expected = np.divide([correct, sums], counts)
    np.testing.assert_allclose(shares(found), expected)
    gaps = [abs(c / n - s / n) * n for c, n, s in zip(correct, counts, sums, strict=True)]
    assert calibration_error(found) == pytest.approx(sum(gaps) / sum(counts))
    found = reliability(np.array([0.0, 1.0, 1.0]), np.array([False, True, False]), bins=4)
    assert found[0].tolist() == [1, 0, 0, 2]  # both ends belong to bins
    np.testing.assert_array_equal(shares(found)[0], [0, np.nan, np.nan, 0.5])
    assert calibration_error(found) == pytest.approx(2 / 3 * 0.5)
    assert np.isnan(calibration_error(reliability(np.zeros(0), np.zeros(0, bool))))
