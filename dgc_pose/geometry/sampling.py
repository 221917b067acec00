"""Values of an image between its pixels, nearest points, and an even choice of points."""

import cv2
import numpy as np

_CHUNK = 30000  # rows at a time: cv2.remap makes no image with a side of 32768 or more
_Parameters = dict[str, bool | int | float | str]
_EXACT_TREE: _Parameters = {"algorithm": 4, "leaf_max_size": 10}  # FLANN's single k-d tree
_ALL_LEAVES: _Parameters = {"checks": -1}  # search every leaf that may hold a nearer point
_CANDIDATES = 4  # in single precision; the nearest of them in double precision is taken


def bilinear(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (N, P[, C]) of an image (H, W[, C]) at points (N, P, 2), its edge repeated."""
    return bilinear_at(image, points[..., 0], points[..., 1])


def bilinear_at(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """As `bilinear`, for points by their coordinates, (N, P) each."""
    x, y = (np.ascontiguousarray(axis, np.float32) for axis in (x, y))
    values = np.empty((*x.shape, *image.shape[2:]), image.dtype)
    for i in range(0, len(x), _CHUNK):
        rows = slice(i, i + _CHUNK)
        values[rows] = cv2.remap(
            image, x[rows], y[rows], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return values


def nearest(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N, count) float32 of each of points (N, D) to its nearest points, itself among
    them, and their indices (N, count) int32. N is at least `count`; equal distances have any order.
    By OpenCV's FLANN: the import of SciPy takes as long as a pose."""
    return _search(points, points, count)


def nearest_to(queries: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distance (N,) float64 of each of `queries` (N, 2) to the nearest of `points` (M, 2), and
    the index (N,) of this point, any of equally near ones; infinite and 0 if there is no point."""
    if len(queries) == 0 or len(points) == 0:
        return np.full(len(queries), np.inf), np.zeros(len(queries), np.int32)
    _, index = _search(queries, points, min(_CANDIDATES, len(points)))
    distance = np.linalg.norm(points[index] - queries[:, None], axis=-1)
    best = distance.argmin(1)
    rows = np.arange(len(queries))
    return distance[rows, best], index[rows, best]


def _search(queries: np.ndarray, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    tree = cv2.flann.Index(np.ascontiguousarray(points, np.float32), _EXACT_TREE)
    asked = np.ascontiguousarray(queries, np.float32)
    index, squared = tree.knnSearch(asked, count, params=_ALL_LEAVES)
    return np.sqrt(squared), index


def spread(
    points: np.ndarray,
    strength: np.ndarray,
    size: tuple[int, ...],
    most: int,
    side: float = 1.0,
    growth: float = 1.1,
) -> np.ndarray:
    """Indices of at most `most` of the points (N, 2) in an image of `size` (width, height): the
    strongest of each square block. side: of the smallest blocks; it grows by the factor `growth`
    until at most `most` blocks have points."""
    order = np.argsort(-strength, kind="stable")
    x, y = points[order].T
    while True:
        blocks = np.floor(x / side) + np.floor(y / side) * (size[0] // side + 1)
        if np.count_nonzero(np.diff(np.sort(blocks))) < most:
            _, first = np.unique(blocks, return_index=True)
            return np.sort(order[first])
        side *= growth
