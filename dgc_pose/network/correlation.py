"""Correlation of cells, neighbourhood consensus by belief propagation (ours), and peaks.

Works on NumPy arrays and torch tensors with any leading (batch) dimensions. Scores are
(..., h1 * w1, h2 * w2): source cells, column by column, by target cells, row by row.
"""

import importlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dgc_pose.network.config import FLOOR, PEAK_WINDOW, REACH, WEIGHT

Array = Any  # of NumPy or torch
Grid = tuple[int, int]  # rows and columns
Scales = Sequence[Sequence[Array]]  # levels at full scale, and at the second, the coarsest first


def _library(values: Array) -> Any:
    """NumPy or torch, whichever has made the values. Imports torch only for its tensors."""
    return np if isinstance(values, np.ndarray) else importlib.import_module("torch")


def _like(values: np.ndarray, other: Array) -> Array:
    """Values as an array of the library, type and device of another."""
    return values.astype(other.dtype) if isinstance(other, np.ndarray) else other.new_tensor(values)


def log_softmax(values: Array, axis: int) -> Array:
    """As torch's. SciPy's would take 0.4 s to import."""
    if not isinstance(values, np.ndarray):
        return values.log_softmax(axis)
    shifted: np.ndarray = values - values.max(axis, keepdims=True)
    shifted -= np.log(np.exp(shifted).sum(axis, keepdims=True))
    return shifted


def match_evidence(source: Sequence[Array], target: Sequence[Array], scales: Array) -> Array:
    """The sum of the levels' `cell_correlation`, the coarsest first, weighted by `scales`, their
    inverse temperatures (levels,)."""
    pairs = enumerate(zip(source, target, strict=True))
    return sum(scales[index] * cell_correlation(*pair, side=2**index) for index, pair in pairs)


def pooled_evidence(source: Scales, target: Scales, scales: Array) -> Array:
    """For each pair of cells, the largest `match_evidence` of three comparisons: of both images at
    full scale, and of each with the other at the second scale."""
    full1, smaller1 = source
    full2, smaller2 = target
    evidence = match_evidence(full1, full2, scales)
    for pair in ((smaller1, full2), (full1, smaller2)):
        evidence = _library(evidence).maximum(evidence, match_evidence(*pair, scales))
    return evidence


def cell_correlation(source: Array, target: Array, side: int) -> Array:
    """Scores of cells of side x side features each, from (..., C, h1 side, w1 side) and
    (..., C, h2 side, w2 side): the largest correlation of a target feature with the source cell's
    features, averaged over the target cell's features."""
    library = _library(source)
    *batch, channels, _, _ = source.shape
    # (..., C, h, y, w, x), y and x inside a cell
    split1, split2 = (
        level.reshape(*batch, channels, *(n for s in level.shape[-2:] for n in (s // side, side)))
        for level in (source, target)
    )
    columns = library.moveaxis(split1, (-3, -1, -2, -4, -5), (-5, -4, -3, -2, -1))
    rows = library.moveaxis(split2, (-5, -3, -1, -4, -2), (-5, -4, -3, -2, -1))
    scores = columns.reshape(*batch, -1, channels) @ rows.reshape(*batch, channels, -1)
    count = scores.shape[-2] // side**2
    scores = scores.reshape(*batch, side**2, count, side**2, -1)
    return library.amax(scores, -4).mean(-2)


def match_scores(evidence: Array) -> Array:
    """Log-likelihood of a match for each pair of cells, up to a constant: the softmax over the
    source times the softmax over the target (dual softmax)."""
    return log_softmax(evidence, -2) + log_softmax(evidence, -1)


def consensus(scores: Array, passes: int, source: Grid, target: Grid) -> Array:
    """Log-probabilities of each target cell's source cell, after `passes` rounds of sum-product
    belief propagation on the grid of target cells. The matches (s + d, t + d) of the eight
    neighbours of t support a match (s, t). They are blurred over s, because views are rotated,
    scaled and distorted."""
    library = _library(scores)
    # A Gaussian over the source's cells, column by column on both axes.
    axes = (np.arange(side, dtype=np.float32) for side in source[::-1])
    along_x, along_y = (np.exp(-((a[:, None] - a) ** 2) / (2 * REACH**2)) for a in axes)
    blur = _like(np.kron(along_x, along_y) / np.float32(2 * math.pi * REACH**2), scores)
    belief = log_softmax(scores, -2)
    for _ in range(passes):
        messages = library.log(blur @ library.exp(belief) + FLOOR)
        support = _sum_of_neighbours(messages.reshape(*scores.shape[:-2], *source[::-1], *target))
        belief = log_softmax(scores + WEIGHT * support.reshape(scores.shape), -2)
    return belief


def _sum_of_neighbours(messages: Array) -> Array:
    """The sum over the eight offsets d of the messages (..., w1, h1, h2, w2) at (s + d, t + d).
    Source cells outside the grid have the smallest message, target cells outside have none."""
    *batch, columns, rows, height, width = messages.shape
    shape = (*batch, columns + 2, rows + 2, height + 2, width + 2)
    if isinstance(messages, np.ndarray):
        padded = np.zeros(shape, messages.dtype)
    else:
        padded = messages.new_zeros(shape)
    padded[..., 1:-1, 1:-1] = math.log(FLOOR)
    padded[..., 1:-1, 1:-1, 1:-1, 1:-1] = messages
    total = _library(messages).zeros_like(messages)
    for y, x in np.ndindex(3, 3):
        if (y, x) != (1, 1):
            total += padded[..., x : x + columns, y : y + rows, y : y + height, x : x + width]
    return total


def peaks(scores: Array, source: Grid) -> tuple[Array, Array]:
    """For each target cell, x and y (..., 2, h2 * w2) of its peak, in source cells: the weighted
    mean in a window around the most probable cell (without the window, a second peak would pull the
    mean between both); and the probability (..., h2 * w2) inside the window."""
    library = _library(scores)
    probability = library.exp(log_softmax(scores, -2))
    cells = _like(np.stack(np.divmod(np.arange(source[0] * source[1]), source[0])), scores)
    best = cells[:, probability.argmax(-2)]  # (2, ..., h2 * w2)
    x, y = (abs(axis[:, None] - near[..., None, :]) for axis, near in zip(cells, best, strict=True))
    weights = library.where(library.maximum(x, y) > PEAK_WINDOW, 0 * probability, probability)
    inside = weights.sum(-2)
    return cells @ weights / inside[..., None, :], inside
