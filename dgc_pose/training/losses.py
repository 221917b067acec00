"""The losses: contrastive for the encoder; map and mask at each level for the decoders.

Means are over the batches of all processes: each process gets its part of the mean, and the parts
sum to it.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.network.consensus import consensus
from dgc_pose.network.correlation import match_scores
from dgc_pose.training.processes import joint_sum


def joint_mean(values: Tensor, inside: Tensor) -> Tensor:
    """This process's part of the mean of `values` where `inside` holds; 0 where it never does.

    NaN or infinity at the other places does not reach the sum.
    """
    count = joint_sum(inside.sum())
    return torch.where(inside, values, 0).sum() / count.clamp(min=1)


def contrastive_loss(
    logits: Tensor, truth: Tensor, valid: Tensor, stride: int, passes: int = 0
) -> tuple[Tensor, Tensor]:
    """InfoNCE on true correspondences, in both directions, and the share found.

    logits: (B, h * w, Q): every source cell, column-major, against Q target cells; truth:
    (B, Q, 2) source pixels of those, `valid` (B, Q) where. Each valid target cell must find its
    place among all source cells (the four around the true place share it, bilinearly), and that
    place must find the cell among all target cells given. Returns the loss and the share of valid
    cells whose best source cell lies within 1.5 cells of the truth.

    passes: where Q is the whole grid, each target cell must find its place once more, after so
    many rounds of `consensus`.
    """
    size = math.isqrt(logits.shape[1])
    truth = torch.where(valid[..., None], truth, 0)
    cells = (truth + 0.5) / stride - 0.5  # the true place in source cells
    scores = match_scores(logits)
    index, weight = _bilinear_cells(cells, size)
    likely = scores / 2
    if passes > 0:
        grid = scores.view(*scores.shape[:2], size, size)
        likely = likely + consensus(grid, passes).flatten(2)
    loss = -joint_mean((likely.gather(1, index) * weight).sum(1), valid)
    best = logits.detach().argmax(1)
    found = torch.stack([torch.div(best, size, rounding_mode="floor"), best % size], -1)
    near = (found - cells).norm(dim=-1) < 1.5
    return loss, joint_mean(near.float(), valid)


def _bilinear_cells(cells: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The four cells around places (B, N, 2): column-major indices (B, 4, N), and their weights."""
    cells = cells.clamp(0, size - 1)
    low = cells.floor().clamp(max=size - 2)
    fraction = cells - low
    x, y = low.long().unbind(-1)
    fx, fy = fraction.unbind(-1)
    first = x * size + y
    index = torch.stack([first, first + 1, first + size, first + size + 1], 1)
    weight = torch.stack([(1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy], 1)
    return index, weight


def map_loss(error_cells: Tensor, valid: Tensor, robust_cells: float | None) -> Tensor:
    """Mean over valid cells of |dx| + |dy| (paper, equation 3), here in cells of the level.

    error_cells: (B, H, W, 2). With `robust_cells` = c the sum e is taken as c log(1 + e / c): a
    level cannot mend what the level before it lost, and should not be pulled by it.
    """
    error = error_cells.abs().sum(-1)
    if robust_cells is not None:
        error = robust_cells * torch.log1p(error / robust_cells)
    return joint_mean(error, valid)


def mask_loss(logits: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """Mean binary cross-entropy of matchability logits (B, 1, H, W) (paper, equation 4).

    target: (B, H, W) bool; it counts where `known`, likewise, holds.
    """
    entropy = F.binary_cross_entropy_with_logits(logits[:, 0], target.to(logits), reduction="none")
    return joint_mean(entropy, known)
