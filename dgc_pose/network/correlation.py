"""Correlation of features, neighbourhood consensus by belief propagation (ours), and peaks."""

import itertools
import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.network.constants import EPSILON, FLOOR, PEAK_WINDOW, REACH, WEIGHT


def l2_normalise(features: Tensor) -> Tensor:
    """Unit length over the channels of (B, C, H, W): f / sqrt(sum f^2 + 1e-6)."""
    return features / torch.sqrt(features.square().sum(1, keepdim=True) + EPSILON)


def global_correlation(source: Tensor, target: Tensor) -> Tensor:
    """Every source cell against every target cell (paper, section 3.2).

    Takes (B, C, h1, w1) and (B, C, h2, w2); returns (B, h1 * w1, h2, w2): channel xs * h1 + ys
    (column-major over the source) at (yt, xt) is <source(ys, xs), target(yt, xt)>.
    """
    batch, _, height, width = target.shape
    columns = source.transpose(2, 3).flatten(2)  # (B, C, xs * h + ys)
    scores = torch.bmm(columns.transpose(1, 2), target.flatten(2))
    return scores.view(batch, -1, height, width)


def local_correlation(warped: Tensor, target: Tensor, radius: int) -> Tensor:
    """Target cells against the warped source in a window around the same cell.

    Takes (B, C, H, W) of both; returns (B, (2 radius + 1)^2, H, W), channels row by row over
    (dy, dx) from -radius to radius: <warped(y + dy, x + dx), target(y, x)>, zero outside.
    """
    height, width = target.shape[2:]
    padded = F.pad(warped, (radius,) * 4)
    scores = [
        (padded[:, :, dy : dy + height, dx : dx + width] * target).sum(1)
        for dy, dx in itertools.product(range(2 * radius + 1), repeat=2)
    ]
    return torch.stack(scores, 1)


def cell_correlation(source: Tensor, target: Tensor, side: int) -> Tensor:
    """As `global_correlation`, of cells that hold side x side features each.

    Takes (B, C, h1 side, w1 side) and (B, C, h2 side, w2 side); returns (B, h1 * w1, h2, w2): the
    largest correlation of a target feature with the source cell's features, averaged over the
    target cell's features.
    """
    if side == 1:
        return global_correlation(source, target)
    batch, channels, height, width = target.shape
    h2, w2 = height // side, width // side
    h1, w1 = source.shape[2] // side, source.shape[3] // side
    columns = source.view(batch, channels, h1, side, w1, side).permute(0, 3, 5, 4, 2, 1)
    rows = target.view(batch, channels, h2, side, w2, side).permute(0, 1, 3, 5, 2, 4)
    scores = torch.bmm(
        columns.reshape(batch, -1, channels), rows.reshape(batch, channels, -1)
    ).view(batch, side**2, h1 * w1, side**2, h2 * w2)
    return scores.amax(1).mean(2).view(batch, h1 * w1, h2, w2)


def cell_correlations(source: Sequence[Tensor], target: Sequence[Tensor]) -> list[Tensor]:
    """`cell_correlation` of the coarsest level's cells by each level, the coarsest first."""
    levels = enumerate(zip(source, target, strict=True))
    return [cell_correlation(*pair, side=2**index) for index, pair in levels]


def match_evidence(correlations: Sequence[Tensor], scales: Tensor) -> Tensor:
    """The weighted sum (B, h1 * w1, h2, w2) of the levels' correlations.

    correlations: (B, h1 * w1, h2, w2) of each level, by `cell_correlations`; scales: (levels,)
    inverse temperatures.
    """
    return torch.tensordot(scales, torch.stack(list(correlations)), 1)


def match_scores(evidence: Tensor) -> Tensor:
    """Log-likelihood of a match for each pair of cells, up to a constant (dual softmax).

    evidence: (B, h1 * w1, h2, w2); the softmax over the source and that over the target are
    multiplied.
    """
    logits = evidence.flatten(2)
    return (logits.log_softmax(1) + logits.log_softmax(2)).view_as(evidence)


def consensus(scores: Tensor, passes: int, grid: tuple[int, int] | None = None) -> Tensor:
    """Log-probabilities of each target cell's source cell, after belief propagation.

    scores: (B, h1 * w1, h2, w2) log-likelihoods, laid out as by `global_correlation`; grid:
    (h1, w1), by default (h2, w2). Sum-product belief propagation on the grid of target cells, with
    `passes` rounds: the match (s, t) of a target cell t is supported by the matches (s + d, t + d)
    of its eight neighbours, blurred over s, as views are rotated, scaled and distorted.
    """
    batch, _, height, width = scores.shape
    rows, columns = grid or (height, width)
    # A Gaussian over the source's cells, column by column on both axes.
    axes = (torch.arange(n, dtype=scores.dtype, device=scores.device) for n in (columns, rows))
    along_x, along_y = (torch.exp(-((a[:, None] - a) ** 2) / (2 * REACH**2)) for a in axes)
    blur = torch.kron(along_x, along_y) / (2 * math.pi * REACH**2)
    belief = scores.log_softmax(1)
    for _ in range(passes):
        messages = torch.matmul(blur, belief.exp().flatten(2)).add(FLOOR).log()
        support = _sum_of_neighbours(messages.view(batch, columns, rows, height, width))
        belief = (scores + WEIGHT * support.view_as(scores)).log_softmax(1)
    return belief


def _sum_of_neighbours(messages: Tensor) -> Tensor:
    """The sum of the messages at (s + d, t + d) over the eight offsets d, of (B, w1, h1, h2, w2).

    Messages about cells outside the source have the smallest value; there are none from cells
    outside the target.
    """
    columns, rows, height, width = messages.shape[1:]
    messages = F.pad(messages, (0, 0, 0, 0, 1, 1, 1, 1), value=math.log(FLOOR))
    messages = F.pad(messages, (1, 1, 1, 1))
    neighbours = [
        messages[:, dx : dx + columns, dy : dy + rows, dy : dy + height, dx : dx + width]
        for dy, dx in itertools.product(range(3), repeat=2)
        if (dy, dx) != (1, 1)
    ]
    return torch.stack(neighbours).sum(0)


def peaks(
    scores: Tensor, grid: tuple[int, int] | None = None, window: int = PEAK_WINDOW
) -> tuple[Tensor, Tensor]:
    """The soft-argmax of each target cell's scores within a window, and its probability.

    Takes logarithms (B, h1 * w1, h2, w2), laid out as by `global_correlation`. grid: (h1, w1), by
    default (h2, w2). Returns x and y in source cells (B, 2, h2, w2), the mean of the source cells
    within `window` of the highest, weighted by their probability (without the window, a second peak
    would pull the mean between both); and the probability (B, h2, w2) inside the window.
    """
    batch, cells, height, width = scores.shape
    rows = height if grid is None else grid[0]
    probability = scores.flatten(2).softmax(1)
    index = torch.arange(cells, device=scores.device)
    x = torch.div(index, rows, rounding_mode="floor").to(scores.dtype)
    y = torch.remainder(index, rows).to(scores.dtype)
    best = probability.argmax(1)  # (B, h2 * w2)
    far = torch.maximum(
        (x[None, :, None] - x[best][:, None]).abs(), (y[None, :, None] - y[best][:, None]).abs()
    )
    weights = probability.masked_fill(far > window, 0)
    inside = weights.sum(1)
    mean = torch.stack([(weights * x[:, None]).sum(1), (weights * y[:, None]).sum(1)], 1)
    mean = mean / inside[:, None]
    return mean.view(batch, 2, height, width), inside.view(batch, height, width)
