"""A subsample of points that is spread evenly over an image, for plots that stay readable."""

from __future__ import annotations

import numpy as np


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Choose points one after the other, each the farthest from all that were chosen before.

    Points that stand where a chosen one stands are passed over, so that fewer than `count` come
    back where fewer places are taken.

    Args:
        points: (N, 2) pixels, finite.
        count: how many to choose at most.

    Returns:
        Indices (M,) in increasing order, M <= min(N, count).
    """
    distances = np.full(len(points), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(count, len(points)):
        farthest = int(np.argmax(distances))
        if distances[farthest] == 0:
            break
        chosen.append(farthest)
        distances = np.minimum(distances, np.sum((points - points[farthest]) ** 2, axis=1))
    return np.array(sorted(chosen), dtype=np.intp)
