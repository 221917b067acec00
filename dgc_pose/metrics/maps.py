"""Errors of a dense correspondence map and of a matchability mask."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgc_pose.errors import InputError


def endpoint_errors(
    map: np.ndarray, truth: np.ndarray, valid: np.ndarray, per_axis: bool = False
) -> np.ndarray:
    """Distances (N,) float64 between map and truth at the N valid cells, in the maps' unit.

    map, truth: (..., 2); valid: (...) bool. Euclidean, or max(|dx|, |dy|) with `per_axis`.
    Raises InputError where the shapes do not agree.
    """
    offsets = _valid_offsets(map, truth, valid)
    return np.abs(offsets).max(axis=1) if per_axis else np.linalg.norm(offsets, axis=1)


def aepe(map: np.ndarray, truth: np.ndarray, valid: np.ndarray) -> float:
    """Average end-point error: mean Euclidean distance over the valid cells, in the maps' unit.

    map, truth: (..., 2); valid: (...) bool. NaN where no cell is valid.
    Raises InputError where the shapes do not agree.
    """
    errors = endpoint_errors(map, truth, valid)
    return float(errors.mean()) if len(errors) else float("nan")


def pck(
    map: np.ndarray,
    truth: np.ndarray,
    valid: np.ndarray,
    thresholds: Sequence[float] | np.ndarray,
    per_axis: bool = False,
) -> np.ndarray:
    """Share in [0, 1] of the valid cells whose error is at most each threshold ("percentage of
    correct keypoints").

    map, truth: (..., 2); valid: (...) bool; thresholds: (K,) in the maps' unit, such as
    alpha * 240 for maps in pixels of 240 x 240. The error is the Euclidean distance; with
    `per_axis` it is max(|dx|, |dy|), as in the DGC-Net authors' evaluation: never stricter.
    Returns (K,), NaN where no cell is valid. Raises InputError where the shapes do not agree.
    """
    errors = endpoint_errors(map, truth, valid, per_axis)
    if len(errors) == 0:
        return np.full(np.shape(thresholds), np.nan)
    return count_within(errors, thresholds) / len(errors)


def count_within(errors: np.ndarray, thresholds: Sequence[float] | np.ndarray) -> np.ndarray:
    """How many of the errors (N,) are at most each threshold (K,): (K,) int. NaN never is."""
    # NaN sorts last, beyond every threshold.
    return np.searchsorted(np.sort(errors), np.asarray(thresholds, np.float64), side="right")


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two masks of the same shape, in [0, 1]; 1 where both are empty.

    Both must be bool: a matchability is thresholded by the caller. Raises InputError otherwise.
    """
    if prediction.dtype != np.bool_ or truth.dtype != np.bool_ or prediction.shape != truth.shape:
        raise InputError(
            f"prediction and truth must be bool masks of one shape, not {prediction.dtype} "
            f"{prediction.shape} and {truth.dtype} {truth.shape}"
        )
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0


def _valid_offsets(map: np.ndarray, truth: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """map - truth of the valid cells: (N, 2) float64."""
    if map.shape != truth.shape or map.shape[-1:] != (2,):
        raise InputError(f"map and truth must have one shape (..., 2): {map.shape}, {truth.shape}")
    if valid.shape != map.shape[:-1] or valid.dtype != np.bool_:
        raise InputError(f"valid must be bool of shape {map.shape[:-1]}, not {valid.shape}")
    return map[valid].astype(np.float64) - truth[valid].astype(np.float64)
