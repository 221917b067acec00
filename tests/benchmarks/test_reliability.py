"""Counts by confidence and the calibration error, against loops over single matches."""

import numpy as np
import pytest

from dgc_pose.benchmarks.reliability import Reliability


def test_every_bin_counts_its_own_matches_and_parts_add_up() -> None:
    rng = np.random.default_rng(5)
    confidence = rng.random((20, 30)).astype(np.float32)
    matches = confidence, rng.random((20, 30)) < confidence**2
    found, rest = (
        Reliability.of(*(array[rows] for array in matches), bins=7)
        for rows in (slice(4), slice(4, None))
    )
    found += rest
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


def test_both_ends_belong_to_bins_and_empty_bins_say_nothing() -> None:
    found = Reliability.of(np.array([0.0, 1.0, 1.0]), np.array([False, True, False]), bins=4)
    assert found.counts.tolist() == [1, 0, 0, 2]
    np.testing.assert_array_equal(found.share_correct, [0, np.nan, np.nan, 0.5])
    assert found.calibration_error == pytest.approx(2 / 3 * 0.5)
    assert np.isnan(Reliability.of(np.zeros(0), np.zeros(0, bool)).calibration_error)
