"""Nearest neighbours in the plane, by a k-d tree."""

import cv2
import numpy as np

_Parameters = dict[str, bool | int | float | str]
_EXACT_TREE: _Parameters = {"algorithm": 4, "leaf_max_size": 10}  # FLANN's single k-d tree
_ALL_LEAVES: _Parameters = {"checks": -1}  # that may hold a nearer point


def nearest(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N, count) float32 of the nearest of points (N, 2) to each, and their indices
    (N, count) int32, itself among them. N is at least `count`; of equal distances any come first.

    By OpenCV's FLANN: the same trees of SciPy cost a command as much time at its start as a pose.
    """
    tree = cv2.flann.Index(np.ascontiguousarray(points, np.float32), _EXACT_TREE)
    index, squared = tree.knnSearch(points.astype(np.float32), count, params=_ALL_LEAVES)
    return np.sqrt(squared), index
