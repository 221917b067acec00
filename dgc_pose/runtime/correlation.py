"""Correlation, consensus and peaks of a pair in NumPy; see `network.correlation`.

Scores are (h1 * w1, h2 * w2): of each source cell, column by column, for each target cell, row by
row.
"""

import math
from collections.abc import Sequence

import numpy as np

from dgc_pose.network.constants import EPSILON, FLOOR, PEAK_WINDOW, REACH, WEIGHT
from dgc_pose.system.threads import in_threads

Grid = tuple[int, int]  # rows and columns


def l2_normalised(features: np.ndarray) -> np.ndarray:
    """Unit length over the channels of (C, H, W): f / sqrt(sum f^2 + 1e-6)."""
    squares = np.einsum("chw,chw->hw", features, features)
    return features * (1 / np.sqrt(squares + np.float32(EPSILON)))


def local_correlation(warped: np.ndarray, target: np.ndarray, radius: int) -> np.ndarray:
    """((2 radius + 1)^2, H, W) float32 from (C, H, W) of both: target cells against the warped
    source in a window around the same cell.

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


def match_evidence(
    source: Sequence[np.ndarray], target: Sequence[np.ndarray], scales: np.ndarray
) -> np.ndarray:
    """The sum of the levels' correlations, the coarsest first, weighted by `scales`."""
    pairs = enumerate(zip(source, target, strict=True))
    return sum(
        scale * _cell_correlation(*pair, side=2**index)
        for scale, (index, pair) in zip(scales, pairs, strict=True)
    )


def _cell_correlation(source: np.ndarray, target: np.ndarray, side: int) -> np.ndarray:
    """Scores of cells that hold side x side features each, from (C, h1 side, w1 side) and (C, h2
    side, w2 side): the largest correlation of a target feature with the source cell's features,
    averaged over the target cell's features."""
    channels = len(source)
    columns = _cells(source, side).transpose(2, 4, 3, 1, 0).reshape(-1, channels)
    rows = _cells(target, side).transpose(0, 2, 4, 1, 3).reshape(channels, -1)
    scores = (columns @ rows).reshape(side**2, len(columns) // side**2, side**2, -1)
    return scores.max(0).mean(1)


def _cells(features: np.ndarray, side: int) -> np.ndarray:
    """(C, h side, w side) as (C, h, side, w, side)."""
    channels, height, width = features.shape
    return features.reshape(channels, height // side, side, width // side, side)


def match_scores(evidence: np.ndarray) -> np.ndarray:
    """Log-likelihood of a match for each pair of cells, up to a constant (dual softmax)."""
    return log_softmax(evidence, 0) + log_softmax(evidence, 1)


def log_softmax(values: np.ndarray, axis: int) -> np.ndarray:
    """As SciPy's, which takes 0.4 s to import."""
    shifted: np.ndarray = values - values.max(axis, keepdims=True)
    shifted -= np.log(np.exp(shifted).sum(axis, keepdims=True))
    return shifted


def consensus(scores: np.ndarray, passes: int, source: Grid, target: Grid) -> np.ndarray:
    """Log-probabilities of each target cell's source cell, after `passes` rounds of belief
    propagation; see `network.correlation.consensus`."""
    # A Gaussian over the source's cells, column by column on both axes.
    axes = (np.arange(side, dtype=np.float32) for side in source[::-1])
    along_x, along_y = (np.exp(-((a[:, None] - a) ** 2) / (2 * REACH**2)) for a in axes)
    blur = np.kron(along_x, along_y) / np.float32(2 * math.pi * REACH**2)
    belief = log_softmax(scores, 0)
    for _ in range(passes):
        messages = np.log(blur @ np.exp(belief) + np.float32(FLOOR))
        support = _sum_of_neighbours(messages.reshape(*source[::-1], *target))
        belief = log_softmax(scores + np.float32(WEIGHT) * support.reshape(scores.shape), 0)
    return belief


def _sum_of_neighbours(messages: np.ndarray) -> np.ndarray:
    """The sum of the messages at (s + d, t + d) over the eight offsets d, of (w1, h1, h2, w2).

    Messages about cells outside the source have the smallest value; there are none from cells
    outside the target.
    """
    columns, rows, height, width = messages.shape
    padded = np.zeros((columns + 2, rows + 2, height + 2, width + 2), np.float32)
    padded[:, :, 1:-1, 1:-1] = math.log(FLOOR)
    padded[1:-1, 1:-1, 1:-1, 1:-1] = messages
    total = np.zeros_like(messages)
    for y, x in np.ndindex(3, 3):
        if (y, x) != (1, 1):
            total += padded[x : x + columns, y : y + rows, y : y + height, x : x + width]
    return total


def peaks(scores: np.ndarray, source: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The soft-argmax of each target cell's scores within a window, and its probability.

    Returns x and y in source cells (2, h2 * w2), the mean of the cells near the highest, weighted
    by their probability; and the probability (h2 * w2,) inside the window.
    """
    probability = np.exp(log_softmax(scores, 0))
    x, y = np.divmod(np.arange(len(scores)), source[0])
    best = probability.argmax(0)
    far = np.maximum(np.abs(x[:, None] - x[best]), np.abs(y[:, None] - y[best]))
    weights = np.where(far > PEAK_WINDOW, np.float32(0), probability)
    inside = weights.sum(0)
    mean = np.stack([x, y]).astype(np.float32) @ weights / inside
    return mean, inside
