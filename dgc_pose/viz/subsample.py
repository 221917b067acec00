"""An evenly spread subsample of points, so that plots stay readable."""

from __future__ import annotations

import numpy as np


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Farthest point sampling: each point is the farthest from all that were chosen before.

    points: (N, 2) pixels, finite. Returns at most `count` indices (M,) in increasing order, of
    points that all differ.
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
