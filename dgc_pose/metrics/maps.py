"""Errors of a dense correspondence map and of a matchability mask."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgc_pose.errors import InputError


def endpoint_errors(
    map: np.ndarray, truth: np.ndarray, valid: np.ndarray, per_axis: bool = False
) -> np.ndarray:
    """Distances (N,) float64 between map and truth at the N valid cells, in the maps' unit.

    map, truth: (..., 2); valid: (...) bool. Euclidean; with `per_axis` max(|dx|, |dy|), as in the
    DGC-Net authors' evaluation, which is never stricter. Raises InputError if the shapes do not
    agree.
    """
    offsets = _valid_offsets(map, truth, valid)
    return np.abs(offsets).max(axis=1) if per_axis else np.linalg.norm(offsets, axis=1)


def aepe(map: np.ndarray, truth: np.ndarray, valid: np.ndarray) -> float:
    """Average end-point error: mean Euclidean distance over the valid cells, in the maps' unit.

    map, truth: (..., 2); valid: (...) bool. NaN if no cell is valid. Raises InputError if the
    shapes do not agree.
    """
    errors = endpoint_errors(map, truth, valid)
    return float(errors.mean()) if len(errors) else float("nan")


def count_within(errors: np.ndarray, thresholds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Number (K,) of errors (N,) that are at most each threshold (K,); NaN never is.

    Over N this is the "percentage of correct keypoints" (PCK).
    """
    # NaN sorts last, beyond every threshold.
    return np.searchsorted(np.sort(errors), np.asarray(thresholds, np.float64), side="right")


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two masks of the same shape, in [0, 1]; 1 if both are empty.

    Both must be bool: the caller thresholds a matchability. Raises InputError otherwise.
    """
    if prediction.dtype != np.bool_ or truth.dtype != np.bool_ or prediction.shape != truth.shape:
        raise InputError(
            f"prediction and truth must be bool masks of one shape, not {prediction.dtype} "
            f"{prediction.shape} and {truth.dtype} {truth.shape}"
        )
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0


def _valid_offsets(map: np.ndarray, truth: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """map - truth at the N valid cells, (N, 2) float64."""
    if map.shape != truth.shape or map.shape[-1:] != (2,):
        raise InputError(f"map and truth must have one shape (..., 2): {map.shape}, {truth.shape}")
    if valid.shape != map.shape[:-1] or valid.dtype != np.bool_:
        raise InputError(f"valid must be bool of shape {map.shape[:-1]}, not {valid.shape}")
    return map[valid].astype(np.float64) - truth[valid].astype(np.float64)
