"""Counts by confidence and the calibration error, against loops over single matches."""

import numpy as np
import pytest

from dgc_pose.benchmarks.reliability import Reliability, draw_reliability
from dgc_pose.viz.figure import new_figure


@pytest.fixture
def matches() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    confidence = rng.random((20, 30)).astype(np.float32)
    return confidence, rng.random((20, 30)) < confidence**2


def test_every_bin_counts_its_own_matches(matches) -> None:
    found = Reliability.of(*matches, bins=7)
    counts, correct, sums = [0] * 7, [0] * 7, [0.0] * 7
    for value, right in zip(matches[0].ravel().tolist(), matches[1].ravel().tolist(), strict=True):
        b = next(b for b in range(7) if value * 7 < b + 1)
        counts[b] += 1
        correct[b] += right
        sums[b] += value
    assert found.counts.tolist() == counts
    assert found.correct.tolist() == correct
    np.testing.assert_allclose(found.mean_confidence, np.divide(sums, counts))
    np.testing.assert_allclose(found.share_correct, np.divide(correct, counts))
    gaps = [abs(c / n - s / n) * n for c, n, s in zip(correct, counts, sums, strict=True)]
    assert found.calibration_error == pytest.approx(sum(gaps) / sum(counts))


def test_parts_add_up_to_the_whole(matches) -> None:
    confidence, right = matches
    parts = Reliability.of(confidence[:4], right[:4]) + Reliability.of(confidence[4:], right[4:])
    whole = Reliability.of(confidence, right)
    assert parts.counts.tolist() == whole.counts.tolist()
    assert parts.calibration_error == pytest.approx(whole.calibration_error)


def test_both_ends_belong_to_bins_and_empty_bins_say_nothing() -> None:
    found = Reliability.of(np.array([0.0, 1.0, 1.0]), np.array([False, True, False]), bins=4)
    assert found.counts.tolist() == [1, 0, 0, 2]
    np.testing.assert_array_equal(found.share_correct, [0, np.nan, np.nan, 0.5])
    assert found.calibration_error == pytest.approx(2 / 3 * 0.5)
    assert np.isnan(Reliability.of(np.zeros(0), np.zeros(0, bool)).calibration_error)


def test_shares_stand_over_the_mean_confidence() -> None:
    confidence = np.array([0.02, 0.06, 0.55, 0.57, 0.53, 0.51])
    reliability = Reliability.of(confidence, np.array([False, False, True, True, True, False]))
    axes = new_figure(4, 3).subplots()
    draw_reliability(axes, {"net": reliability}, right="within 3 px")
    curve = axes.lines[1]
    assert curve.get_xdata().tolist() == pytest.approx([0.04, 0.54])  # empty bins are left out
    assert curve.get_ydata().tolist() == pytest.approx([0, 0.75])
