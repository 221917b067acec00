"""Target cells against the warped source in a window around the same cell, in NumPy."""

from __future__ import annotations

import numpy as np

from dgc_pose.system.threads import in_threads


def local_correlation(warped: np.ndarray, target: np.ndarray, radius: int) -> np.ndarray:
    """((2 radius + 1)^2, H, W) float32 from (C, H, W) of both; see `network.correlation`.

    One pass over the features for each offset, without the arrays of products between, which took
    most of the time in torch and in ONNX Runtime.
    """
    height, width = target.shape[1:]
    padded = np.pad(warped, ((0, 0), (radius, radius), (radius, radius)))
    side = 2 * radius + 1
    scores = np.empty((side**2, height, width), np.float32)

    def correlate(index: int) -> None:
        y, x = divmod(index, side)
        shifted = padded[:, y : y + height, x : x + width]
        np.einsum("chw,chw->hw", shifted, target, out=scores[index])

    in_threads(correlate, range(side**2))
    return scores
