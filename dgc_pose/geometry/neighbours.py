"""Nearest neighbours, by a k-d tree."""

import cv2
import numpy as np

_Parameters = dict[str, bool | int | float | str]
_EXACT_TREE: _Parameters = {"algorithm": 4, "leaf_max_size": 10}  # FLANN's single k-d tree
_ALL_LEAVES: _Parameters = {"checks": -1}  # that may hold a nearer point
_CANDIDATES = 4  # in single precision, of which the nearest in double precision is taken


def nearest(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N, count) float32 of the nearest of points (N, D) to each, and their indices
    (N, count) int32, itself among them. N is at least `count`; of equal distances any come first.

    By OpenCV's FLANN: the same trees of SciPy cost a command as much time at its start as a pose.
    """
    return _search(points, points, count)


def nearest_to(queries: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distance (N,) float64 of each of `queries` (N, 2) to the nearest of `points` (M, 2), and
    that point's index (N,); infinite and 0 if there is no point. Of equal distances any comes."""
    if len(queries) == 0 or len(points) == 0:
        return np.full(len(queries), np.inf), np.zeros(len(queries), np.int32)
    _, index = _search(queries, points, min(_CANDIDATES, len(points)))
    distance = np.linalg.norm(points[index] - queries[:, None], axis=-1)
    best, rows = distance.argmin(1), np.arange(len(queries))
    return distance[rows, best], index[rows, best]


def _search(queries: np.ndarray, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    tree = cv2.flann.Index(np.ascontiguousarray(points, np.float32), _EXACT_TREE)
    asked = np.ascontiguousarray(queries, np.float32)
    index, squared = tree.knnSearch(asked, count, params=_ALL_LEAVES)
    return np.sqrt(squared), index
