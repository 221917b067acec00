"""Neighbours' consent to the matches of the coarsest level, before one of them is chosen (ours)."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

# Chosen on pairs of the photographs that train; from half to twice each, little changes.
_REACH = 1.4  # source cells, deviation of where a neighbour's match may lie from "beside mine"
_WEIGHT = 0.4  # of the neighbours' votes: they are not independent of each other
_DOUBT = 0.01  # what a neighbour that sees nothing here still grants: it may be another surface


def consensus(scores: Tensor, passes: int) -> Tensor:
    """Log-probabilities of each target cell's place in the source, its neighbours heard.

    scores: (B, h * w, h, w) log-likelihoods, laid out as by `global_correlation`. A cell at t that
    matches s is supported by matches (s + d, t + d) of its eight neighbours, blurred over s, since
    views are turned, scaled and bent: sum-product belief propagation on the grid of target cells,
    with `passes` rounds and as many cells of reach.
    """
    batch, _, height, width = scores.shape
    blur = _blur(height, width, scores)
    belief = scores.log_softmax(1)
    for _ in range(passes):
        votes = torch.matmul(blur, belief.exp().flatten(2)).add(_DOUBT).log()
        support = _summed(votes.view(batch, width, height, height, width))
        belief = (scores + _WEIGHT * support.view_as(scores)).log_softmax(1)
    return belief


def _summed(votes: Tensor) -> Tensor:
    """Over the eight neighbours d the votes at (s + d, t + d), of (B, xs, ys, yt, xt).

    Beyond the source nothing can match; beyond the target there is nobody to vote.
    """
    height, width = votes.shape[3:]
    votes = F.pad(votes, (0, 0, 0, 0, 1, 1, 1, 1), value=math.log(_DOUBT))
    votes = F.pad(votes, (1, 1, 1, 1))
    beside = [
        votes[:, dx : dx + width, dy : dy + height, dy : dy + height, dx : dx + width]
        for dy in (0, 1, 2)
        for dx in (0, 1, 2)
        if (dy, dx) != (1, 1)
    ]
    return torch.stack(beside).sum(0)


def _blur(height: int, width: int, like: Tensor) -> Tensor:
    """A Gaussian over the cells of a grid, column-major on both axes: (h * w, h * w)."""
    axes = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (width, height))
    along_x, along_y = (torch.exp(-((a[:, None] - a) ** 2) / (2 * _REACH**2)) for a in axes)
    return torch.kron(along_x, along_y) / (2 * math.pi * _REACH**2)
