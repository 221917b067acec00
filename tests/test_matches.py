"""Matches refuse shapes that do not agree."""

import numpy as np
import pytest

from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.matches import Matches


def test_lists_become_arrays() -> None:
    matches = Matches([[1, 2], [3, 4]], [[5, 6], [7, 8]], [0.5, 1], 1.0)  # type: ignore[arg-type]
    assert len(matches) == 2 and matches.points1.dtype == np.float64


@pytest.mark.parametrize(
    ("points1", "points2", "confidence", "error", "named"),
    [
        (np.zeros((4, 3)), np.zeros((4, 2)), np.zeros(4), 1.0, "points1"),
        (np.zeros((4, 2)), np.zeros(4), np.zeros(4), 1.0, "points2"),
        (np.zeros((4, 2)), np.zeros((3, 2)), np.zeros(4), 1.0, "same length"),
        (np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((4, 1)), 1.0, "confidence"),
        (np.zeros((4, 2)), np.zeros((4, 2)), np.zeros(4), 0.0, "error_px"),
        (np.zeros((4, 2)), np.zeros((4, 2)), np.zeros(4), np.nan, "error_px"),
    ],
)
def test_wrong_shapes_are_named(
    points1: np.ndarray, points2: np.ndarray, confidence: np.ndarray, error: float, named: str
) -> None:
    with pytest.raises(InputError, match=named) as caught:
        Matches(points1, points2, confidence, error)
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, DgcPoseError)
