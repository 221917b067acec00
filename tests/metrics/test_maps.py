"""Map errors and masks, against loops over single cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.metrics import aepe, count_within, endpoint_errors, jaccard


@pytest.fixture
def case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    truth = rng.uniform(0, 240, (2, 6, 7, 2))
    return truth + rng.normal(0, 4, truth.shape), truth, rng.random((2, 6, 7)) < 0.6


def cell_offsets(
    case: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> list[tuple[float, float]]:
    found, truth, valid = case
    return [
        (found[i][0] - truth[i][0], found[i][1] - truth[i][1])
        for i in np.ndindex(valid.shape)
        if valid[i]
    ]


def test_aepe_is_the_mean_distance_over_valid_cells(case) -> None:
    distances = [math.hypot(x, y) for x, y in cell_offsets(case)]
    assert aepe(*case) == pytest.approx(sum(distances) / len(distances))


def test_invalid_cells_do_not_count(case) -> None:
    found, truth, valid = case
    spoilt = np.where(valid[..., None], found, np.nan)
    assert aepe(spoilt, truth, valid) == aepe(*case)
    np.testing.assert_array_equal(endpoint_errors(spoilt, truth, valid), endpoint_errors(*case))


@pytest.mark.parametrize("per_axis", [False, True])
def test_pck_counts_cells(case, per_axis: bool) -> None:
    thresholds = [0.5, 2.0, 5.0, 20.0]
    offsets = cell_offsets(case)
    expected = []
    for threshold in thresholds:
        near = [
            (abs(x) <= threshold and abs(y) <= threshold)
            if per_axis
            else math.hypot(x, y) <= threshold
            for x, y in offsets
        ]
        expected.append(sum(near) / len(near))
    errors = endpoint_errors(*case, per_axis=per_axis)
    np.testing.assert_allclose(count_within(errors, thresholds) / len(errors), expected)


def test_pck_counts_an_error_equal_to_the_threshold_and_never_nan() -> None:
    truth = np.zeros((3, 2))
    found = np.array([[3.0, 4.0], [np.nan, 0.0], [6.0, 8.0]])
    errors = endpoint_errors(found, truth, np.ones(3, bool))
    assert count_within(errors, [5.0, 4.99, 1e9]).tolist() == [1, 0, 2]


def test_errors_come_in_the_order_of_the_valid_cells(case) -> None:
    offsets = cell_offsets(case)
    np.testing.assert_allclose(endpoint_errors(*case), [math.hypot(x, y) for x, y in offsets])
    axes = endpoint_errors(*case, per_axis=True)
    np.testing.assert_allclose(axes, [max(abs(x), abs(y)) for x, y in offsets])


def test_counts_are_of_errors_not_above_the_threshold() -> None:
    errors = np.array([2.0, np.nan, 1.0, np.inf, 2.0])
    assert count_within(errors, [0.5, 1.0, 1.9, 2.0, 1e9, np.inf]).tolist() == [0, 1, 1, 3, 3, 4]


def test_per_axis_is_never_stricter(case) -> None:
    thresholds = np.linspace(0.005, 0.1, 200) * 240
    euclidean = count_within(endpoint_errors(*case), thresholds)
    axes = count_within(endpoint_errors(*case, per_axis=True), thresholds)
    assert np.all(axes >= euclidean) and np.any(axes > euclidean)


def test_no_valid_cell_gives_nan(case) -> None:
    found, truth, valid = case
    assert math.isnan(aepe(found, truth, np.zeros_like(valid)))
    assert endpoint_errors(found, truth, np.zeros_like(valid)).shape == (0,)


def test_jaccard() -> None:
    a = np.array([[True, True, False], [False, False, True]])
    b = np.array([[True, False, False], [True, False, True]])
    assert jaccard(a, b) == 2 / 4
    assert jaccard(a, a) == 1
    assert jaccard(a, ~a) == 0
    assert jaccard(np.zeros(3, bool), np.zeros(3, bool)) == 1


def test_shapes_that_do_not_agree_are_refused(case) -> None:
    found, truth, valid = case
    with pytest.raises(InputError, match="map and truth"):
        aepe(found[:1], truth, valid)
    with pytest.raises(InputError, match="valid"):
        endpoint_errors(found, truth, valid[..., None])
    with pytest.raises(InputError, match="valid"):
        aepe(found, truth, valid.astype(float))
    with pytest.raises(InputError, match="bool"):
        jaccard(valid.astype(float), valid)
