"""Errors of a dense correspondence map and of a matchability mask."""

from collections.abc import Sequence

import numpy as np


def endpoint_errors(
    map: np.ndarray, truth: np.ndarray, valid: np.ndarray, per_axis: bool = False
) -> np.ndarray:
    """Distances (N,) float64 between map and truth at the N valid cells, in the maps' unit.

    map, truth: (..., 2); valid: (...) bool. Euclidean; with `per_axis` max(|dx|, |dy|), as in the
    DGC-Net authors' evaluation, which is never stricter.
    """
    offsets = map[valid].astype(np.float64) - truth[valid].astype(np.float64)
    return np.abs(offsets).max(axis=1) if per_axis else np.linalg.norm(offsets, axis=1)


def count_within(errors: np.ndarray, thresholds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Number (K,) of errors (N,) that are at most each threshold (K,); NaN never is.

    Over N this is the "percentage of correct keypoints" (PCK).
    """
    # NaN sorts last, beyond every threshold.
    return np.searchsorted(np.sort(errors), np.asarray(thresholds, np.float64), side="right")


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of the same shape, in [0, 1]; 1 if both are
    empty."""
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0
