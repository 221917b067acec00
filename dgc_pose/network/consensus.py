"""Neighbourhood consensus at the coarsest level, by belief propagation (ours)."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.network.constants import FLOOR, REACH, WEIGHT


def consensus(scores: Tensor, passes: int, grid: tuple[int, int] | None = None) -> Tensor:
    """Log-probabilities of each target cell's source cell, after belief propagation.

    scores: (B, h1 * w1, h2, w2) log-likelihoods, laid out as by `global_correlation`; grid:
    (h1, w1), by default (h2, w2). Sum-product belief propagation on the grid of target cells, with
    `passes` rounds: the match (s, t) of a target cell t is supported by the matches (s + d, t + d)
    of its eight neighbours, blurred over s, as views are rotated, scaled and distorted.
    """
    batch, _, height, width = scores.shape
    rows, columns = grid or (height, width)
    blur = _blur(rows, columns, scores)
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
        for dy in (0, 1, 2)
        for dx in (0, 1, 2)
        if (dy, dx) != (1, 1)
    ]
    return torch.stack(neighbours).sum(0)


def _blur(height: int, width: int, like: Tensor) -> Tensor:
    """A Gaussian over the cells of a grid, column-major on both axes: (h * w, h * w)."""
    axes = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (width, height))
    along_x, along_y = (torch.exp(-((a[:, None] - a) ** 2) / (2 * REACH**2)) for a in axes)
    return torch.kron(along_x, along_y) / (2 * math.pi * REACH**2)
