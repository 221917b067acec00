"""Map errors and masks, against loops over single cells."""

import math

import numpy as np
import pytest

from dgc_pose.training.evaluation.map_errors import count_within, endpoint_errors, jaccard

Case = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture
def case() -> Case:
    rng = np.random.default_rng(3)
    truth = rng.uniform(0, 240, (2, 6, 7, 2))
    return truth + rng.normal(0, 4, truth.shape), truth, rng.random((2, 6, 7)) < 0.6


def test_errors_are_distances_over_the_valid_cells_in_their_order(case: Case) -> None:
    map, truth, valid = case
    offsets = [map[i] - truth[i] for i in np.ndindex(valid.shape) if valid[i]]
    distances = [math.hypot(x, y) for x, y in offsets]
    spoilt = np.where(valid[..., None], map, np.nan)
    np.testing.assert_allclose(endpoint_errors(spoilt, truth, valid), distances)
    axes = endpoint_errors(*case, per_axis=True)
    np.testing.assert_allclose(axes, [max(abs(x), abs(y)) for x, y in offsets])


def test_counts_are_of_errors_not_above_the_threshold_and_never_of_nan() -> None:
    errors = np.array([2.0, np.nan, 1.0, np.inf, 2.0])
    assert count_within(errors, [0.5, 1.0, 1.9, 2.0, 1e9, np.inf]).tolist() == [0, 1, 1, 3, 3, 4]


def test_jaccard() -> None:
    a = np.array([[True, True, False], [False, False, True]])
    b = np.array([[True, False, False], [True, False, True]])
    assert jaccard(a, b) == 2 / 4
    assert jaccard(a, a) == 1
    assert jaccard(a, ~a) == 0
    assert jaccard(np.zeros(3, bool), np.zeros(3, bool)) == 1
