"""How far matches lie from the true epipolar lines: D_e of the paper's section 4.4."""

from __future__ import annotations

import numpy as np

from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.geometry.epipolar import (
    essential_from_pose,
    fundamental_from_essential,
    symmetric_epipolar_distance,
)


def true_fundamental(pair: Pair) -> np.ndarray:
    """F (3, 3) of a pair by its calibration, for pixels of its cameras: x2^T F x1 = 0."""
    E = essential_from_pose(pair.R, pair.t / np.linalg.norm(pair.t))
    return fundamental_from_essential(E, pair.camera1.K, pair.camera2.K)


def median_and_mean(
    points1: np.ndarray, points2: np.ndarray, F: np.ndarray
) -> tuple[float, float]:
    """Median and mean of the symmetric epipolar distances of matches (..., 2), in pixels.

    A match that is not finite counts as infinitely far, and so do no matches at all.
    """
    first, second = (
        np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in (points1, points2)
    )
    if not len(first):
        return np.inf, np.inf
    finite = np.isfinite(first).all(1) & np.isfinite(second).all(1)
    distances = np.full(len(first), np.inf)
    distances[finite] = symmetric_epipolar_distance(first[finite], second[finite], F)
    return float(np.median(distances)), float(distances.mean())
