"""Matches refuse shapes that do not agree."""

from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.matches import Matches


@pytest.mark.parametrize("count", [0, 1, 5])
def test_points_of_opencv_and_of_a_batch_of_one(count: int) -> None:
    points = np.arange(2.0 * count).reshape(-1, 2)
    for other in (points[:, None], points[None]):
        np.testing.assert_array_equal(Matches(other, points, np.ones(count), 1.0).points1, points)


@pytest.mark.parametrize(
    ("points1", "points2", "confidence", "error", "named"),
    [
        (np.zeros((4, 3)), np.zeros((4, 2)), np.zeros(4), 1.0, "points1"),
        (np.zeros((4, 2)), np.zeros((3, 2)), np.zeros(4), 1.0, "same length"),
        (np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((4, 1)), 1.0, "confidence"),
        (np.zeros((4, 2)), np.zeros((4, 2)), np.zeros(4), np.nan, "error_px"),
        *((np.zeros((1, 2)), np.zeros((1, 2)), [c], 1.0, "confidence") for c in (np.nan, 5, -0.1)),
    ],
)
def test_wrong_shapes_and_values_are_named(
    points1: np.ndarray, points2: np.ndarray, confidence: np.ndarray, error: float, named: str
) -> None:
    with pytest.raises(InputError, match=named) as caught:
        Matches(points1, points2, confidence, error)
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, DgcPoseError)


def _of_rows(rows: list[list[float]], error_px: float, confidence: float) -> Matches:
    points = np.array(rows)
    return Matches(points[:, :2], points[:, 2:], np.full(len(rows), confidence), error_px)


def test_joined_matches_are_there_once_in_order() -> None:
    """Equal to the pixel in both images they are one match, the first of them."""
    first = replace(_of_rows([[9.2, 1, 2, 3], [1, 1, 1, 1]], 0.5, 0.9), weights="abc")
    second = _of_rows([[9.4, 1.1, 1.9, 3], [9.2, 1, 2, 4], [0, 0, 7, 7]], 2.0, 0.4)
    joined = Matches.joined([first, second])
    assert joined.points1.tolist() == [[9.2, 1], [1, 1], [9.2, 1], [0, 0]]
    assert joined.points2.tolist() == [[2, 3], [1, 1], [2, 4], [7, 7]]
    assert joined.confidence.tolist() == [0.9, 0.9, 0.4, 0.4]
    assert joined.error_px == 2.0 and not joined.key_points and joined.weights == "abc"


def test_surroundings_are_finite_or_none() -> None:
    matches = _of_rows([[1, 2, 3, 4]], 1.0, 1.0)
    with pytest.raises(InputError, match="^context_ratio must be finite or None, not"):
        replace(matches, context_ratio=np.nan)
