"""Scores of poses and of matches: the area under the recall curve, and D_e of the paper."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.geometry.epipolar import symmetric_epipolar_distance


def folded(error_deg: float) -> float:
    """min(e, 180 - e): the translation error of the matching literature, which ignores t's sign.

    error_deg: degrees in [0, 180]; infinite for a failure, and so is the result.
    """
    return min(error_deg, abs(180.0 - error_deg))


def pose_auc(errors: ArrayLike, thresholds: Sequence[float] = (5, 10, 20)) -> tuple[float, ...]:
    """Area under the recall curve of pose errors up to each threshold, percent of the full area.

    The curve of the matching literature: straight lines from (0, 0) through the points (e_i, i/N),
    errors in ascending order, and constant from the last error below the threshold on. The area
    under it is exact. Failures are infinite errors and count among the N.

    errors: (N,), N > 0, in the unit of the thresholds, for a pair max(rotation, folded
    translation), never NaN.
    """
    values = np.sort(np.asarray(errors, dtype=np.float64))
    recalls = np.arange(1, len(values) + 1) / len(values)
    return tuple(_auc_percent(values, recalls, threshold) for threshold in thresholds)


def _auc_percent(errors: np.ndarray, recalls: np.ndarray, threshold: float) -> float:
    below = np.searchsorted(errors, threshold)
    x = np.concatenate(([0.0], errors[:below], [threshold]))
    y = np.concatenate(([0.0], recalls[:below]))
    y = np.append(y, y[-1])
    return float(100 * np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2) / threshold)


def median_and_mean(points1: np.ndarray, points2: np.ndarray, F: np.ndarray) -> tuple[float, float]:
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
