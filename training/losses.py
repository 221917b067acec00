"""The losses: of matches between cells for the encoder; map and mask at each level for decoders."""

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.draw import Draw

_ROBUST_CELLS = 4.0  # larger errors of a map count by their logarithm
_LEAST_LOG = -14.0  # of a probability: one wrong truth weighs no more
_RADIUS, _SHARPNESS = 3, 20.0  # cells and inverse temperature of the engine's refinement
_JITTER = 1.5  # cells, of the window about the truth
Grid = tuple[int, int]  # rows and columns


def masked_mean(values: Tensor, inside: Tensor) -> Tensor:
    """The mean of the `values` that are `inside`; 0 if there are none.

    NaN and infinity of the other values do not reach the sum.
    """
    return torch.where(inside, values, 0).sum() / inside.sum().clamp(min=1)


def likelihood_loss(
    log_likely: Tensor, truth: Tensor, valid: Tensor, stride: int, grid: Grid
) -> tuple[Tensor, Tensor]:
    """The mean negative log-likelihood of the true matches, and the share of right cells.

    log_likely: (B, h * w, Q), of every source cell, column-major, for Q target cells; truth:
    (B, Q, 2), their true points in source pixels, each shared bilinearly by the four cells around
    it; valid: (B, Q); grid: h and w. Right is a best cell within 1.5 cells of the truth.
    """
    rows, columns = grid
    cells = (torch.where(valid[..., None], truth, 0) + 0.5) / stride - 0.5
    last = cells.new_tensor([columns - 1, rows - 1])
    bounded = torch.minimum(cells.clamp(min=0), last)
    low = torch.minimum(bounded.floor(), last - 1)
    x, y = low.long().unbind(-1)
    fx, fy = (bounded - low).unbind(-1)
    first = x * rows + y
    index = torch.stack([first, first + 1, first + rows, first + rows + 1], 1)
    weight = torch.stack([(1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy], 1)
    loss = -masked_mean((log_likely.gather(1, index).clamp(min=_LEAST_LOG) * weight).sum(1), valid)
    best = log_likely.detach().argmax(1)
    points = torch.stack([torch.div(best, rows, rounding_mode="floor"), best % rows], -1)
    near = (points - cells).norm(dim=-1) < 1.5
    return loss, masked_mean(near.float(), valid)


def window_loss(
    source: Tensor, target: Tensor, truths: tuple[Tensor, Tensor], draw: Draw, queries: int
) -> Tensor:
    """The cross-entropy of the refinement's soft-argmax, in a window about the truth.

    source, target: unit features (B, C, h, w) of stride 4. Both are averaged over 2x2, the source's
    at every cell, as the engine does. truths: true points (B, h w / 4, 2), pixels, of the
    target's cells of stride 8, of which random `queries` count, and which are valid.
    """
    means, wanted = F.avg_pool2d(source, 2, 1), F.avg_pool2d(target, 2).flatten(2)
    rows, columns = means.shape[2:]
    chosen = random_cells(truths[1], queries, draw)
    points, use = chosen_cells(truths, chosen)
    place = torch.where(use[..., None], (points + 0.5) / 4 - 1, 0)  # in means, between cells
    middle = (place + _JITTER * draw.uniform(*place.shape, low=-1)).round()
    offsets = torch.arange(-_RADIUS, _RADIUS + 1, device=place.device)
    dy, dx = torch.meshgrid(offsets, offsets, indexing="ij")
    x, y = middle[..., :1] + dx.flatten(), middle[..., 1:] + dy.flatten()
    there = (x >= 0) & (y >= 0) & (x < columns) & (y < rows)
    index = (y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1)).long()
    channels = means.shape[1]
    near = means.flatten(2).gather(2, index.flatten(1)[:, None].expand(-1, channels, -1))
    query = wanted.gather(2, chosen[:, None].expand(-1, channels, -1))
    scores = (near.unflatten(2, index.shape[1:]) * query[..., None]).sum(1)
    likely = (_SHARPNESS * scores).masked_fill(~there, -30).log_softmax(-1)
    aside, below = ((at - true).abs() for at, true in zip((x, y), place.split(1, -1), strict=True))
    share = (1 - aside).clamp(min=0) * (1 - below).clamp(min=0) * there
    return masked_mean(-(share * likely).sum(-1), use & (share.sum(-1) > 0.9))


def random_cells(valid: Tensor, count: int, draw: Draw) -> Tensor:
    """Indices (B, n) of random cells of (B, N), `count` at most, valid ones first."""
    order = draw.uniform(*valid.shape) + valid.float()
    return order.topk(min(count, valid.shape[1]), 1).indices


def chosen_cells(truths: tuple[Tensor, Tensor], chosen: Tensor) -> tuple[Tensor, Tensor]:
    """True points (B, n, 2) and their validity (B, n) of the cells (B, n) of all N."""
    points, valid = truths
    return points.gather(1, chosen[..., None].expand(-1, -1, 2)), valid.gather(1, chosen)


def map_loss(error_cells: Tensor, valid: Tensor) -> Tensor:
    """Mean over valid cells of c log(1 + e / c), e = |dx| + |dy|.

    error_cells: (B, H, W, 2), in cells of the level. A level cannot correct large errors of the
    level before it, which should not dominate.
    """
    error = error_cells.abs().sum(-1)
    return masked_mean(_ROBUST_CELLS * torch.log1p(error / _ROBUST_CELLS), valid)


def absolute_map_loss(error: Tensor, valid: Tensor) -> Tensor:
    """Mean over valid cells of |dx| + |dy| (paper, equation 3) of (B, H, W, 2), normalised."""
    return masked_mean(error.abs().sum(-1), valid)


def mask_loss(logits: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """Mean binary cross-entropy of matchability logits (B, 1, H, W) (paper, equation 4).

    target: (B, H, W) bool; only the cells that are `known` (B, H, W) count.
    """
    entropy = F.binary_cross_entropy_with_logits(logits[:, 0], target.to(logits), reduction="none")
    return masked_mean(entropy, known)
