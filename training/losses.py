"""The losses: contrastive for the encoder; map and mask at each level for the decoders."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.network.correlation import match_scores

_ROBUST_CELLS = 4.0  # larger errors of a map count by their logarithm


def masked_mean(values: Tensor, inside: Tensor) -> Tensor:
    """The mean of the `values` that are `inside`; 0 if there are none.

    NaN and infinity of the other values do not reach the sum.
    """
    return torch.where(inside, values, 0).sum() / inside.sum().clamp(min=1)


def contrastive_loss(
    logits: Tensor, truth: Tensor, valid: Tensor, stride: int
) -> tuple[Tensor, Tensor]:
    """InfoNCE on true correspondences, in both directions, and the share of right cells.

    logits: (B, h * w, Q), every source cell, column-major, against Q target cells; truth:
    (B, Q, 2), their true points in source pixels; valid: (B, Q). Each valid target cell is
    classified among all source cells (its true point shared bilinearly by the four cells around
    it), and that point among all target cells given. Returns the loss and the share of valid cells
    whose best source cell lies within 1.5 cells of the truth.
    """
    size = math.isqrt(logits.shape[1])
    truth = torch.where(valid[..., None], truth, 0)
    cells = (truth + 0.5) / stride - 0.5  # the true point in source cells
    likely = match_scores(logits) / 2
    index, weight = _bilinear_cells(cells, size)
    loss = -masked_mean((likely.gather(1, index) * weight).sum(1), valid)
    best = logits.detach().argmax(1)
    points = torch.stack([torch.div(best, size, rounding_mode="floor"), best % size], -1)
    near = (points - cells).norm(dim=-1) < 1.5
    return loss, masked_mean(near.float(), valid)


def _bilinear_cells(cells: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The four cells around points (B, N, 2): column-major indices (B, 4, N), and their weights."""
    cells = cells.clamp(0, size - 1)
    low = cells.floor().clamp(max=size - 2)
    x, y = low.long().unbind(-1)
    fx, fy = (cells - low).unbind(-1)
    first = x * size + y
    index = torch.stack([first, first + 1, first + size, first + size + 1], 1)
    weight = torch.stack([(1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy], 1)
    return index, weight


def map_loss(error_cells: Tensor, valid: Tensor) -> Tensor:
    """Mean over valid cells of c log(1 + e / c), e = |dx| + |dy| (paper, equation 3: of e itself).

    error_cells: (B, H, W, 2), here in cells of the level. A level cannot correct large errors of
    the level before it, which should not dominate.
    """
    error = error_cells.abs().sum(-1)
    return masked_mean(_ROBUST_CELLS * torch.log1p(error / _ROBUST_CELLS), valid)


def mask_loss(logits: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """Mean binary cross-entropy of matchability logits (B, 1, H, W) (paper, equation 4).

    target: (B, H, W) bool; only the cells that are `known` (B, H, W) count.
    """
    entropy = F.binary_cross_entropy_with_logits(logits[:, 0], target.to(logits), reduction="none")
    return masked_mean(entropy, known)
