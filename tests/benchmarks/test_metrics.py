"""The area under the recall curve of cases done by hand, and D_e by its equation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgc_pose.benchmarks.metrics import folded, median_and_mean, pose_auc


def test_the_folded_error_ignores_the_sign() -> None:
    for error, expected in ((180.0, 0), (170.0, 10), (10.0, 10), (90.0, 90), (math.inf, math.inf)):
        assert folded(error) == expected


def test_auc_of_cases_done_by_hand() -> None:
    assert pose_auc([0, 0, 0]) == pytest.approx((100, 100, 100))
    assert pose_auc([math.inf, 90]) == (0, 0, 0)
    # One pair at 4 degrees: a triangle up to 4, level after it.
    assert pose_auc([4], (5, 8)) == pytest.approx((60, 75))
    # A failure beside it halves everything.
    assert pose_auc([math.inf, 4], (5, 8)) == pytest.approx((30, 37.5))


@given(
    st.lists(st.floats(0, 180) | st.just(math.inf), min_size=1, max_size=30),
    st.integers(0, 2**32 - 1),
)
def test_auc_ignores_the_order_stays_in_range_and_falls_with_a_failure(
    errors: list[float], seed: int
) -> None:
    auc = np.array(pose_auc(errors))
    assert np.all((auc >= 0) & (auc <= 100 + 1e-9))
    assert pose_auc(np.random.default_rng(seed).permutation(errors)) == tuple(auc)
    with_failure = np.array(pose_auc([*errors, math.inf]))
    np.testing.assert_allclose(with_failure, auc * len(errors) / (len(errors) + 1))


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
