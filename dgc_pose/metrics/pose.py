"""Errors of a relative pose, and the area under their recall curve."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.errors import InputError


def rotation_error_deg(R: np.ndarray, R_gt: np.ndarray) -> float:
    """Angle of the rotation R_gt^T R between two rotation matrices (3, 3), degrees in [0, 180].

    acos((trace - 1) / 2), computed as an arctangent, which is accurate near 0 and 180 too.
    """
    R = np.asarray(R_gt, dtype=np.float64).T @ np.asarray(R, dtype=np.float64)
    axis = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    # The axis has length 2 sin(angle), and trace - 1 is 2 cos(angle).
    return float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1)))


def translation_error_deg(t: np.ndarray, t_gt: np.ndarray) -> float:
    """Angle between two directions (3,) of any length but 0, degrees in [0, 180]."""
    a, b = (np.asarray(direction, dtype=np.float64) for direction in (t, t_gt))
    a, b = a / np.abs(a).max(), b / np.abs(b).max()
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


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

    errors: (N,), in the unit of the thresholds, for a pair max(rotation, folded translation).
    Raises InputError if errors is empty, or has NaN or negative numbers.
    """
    values = np.sort(np.asarray(errors, dtype=np.float64))
    if values.ndim != 1 or len(values) == 0:
        raise InputError(f"errors must have shape (N,) with N > 0, not {values.shape}")
    if not (values >= 0).all():
        raise InputError("errors must not be negative or NaN: a failure is infinite")
    recalls = np.arange(1, len(values) + 1) / len(values)
    return tuple(_auc_percent(values, recalls, threshold) for threshold in thresholds)


def _auc_percent(errors: np.ndarray, recalls: np.ndarray, threshold: float) -> float:
    below = np.searchsorted(errors, threshold)
    x = np.concatenate(([0.0], errors[:below], [threshold]))
    y = np.concatenate(([0.0], recalls[:below]))
    y = np.append(y, y[-1])
    return float(100 * np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2) / threshold)
