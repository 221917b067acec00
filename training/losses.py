"""The stages of a run and their losses: first the encoder, by matches between cells; then the
decoders on it, by map and mask at each level."""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import (
    COARSEST,
    CORRELATED,
    INPUT_SIZE,
    LEVEL_SIZES,
    SECOND_SIZE,
    STRIDE,
)
from dgc_pose.network.correlation import consensus, match_evidence, match_scores
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet, l2_normalise, normalise, to_normalised, to_pixels, upsample
from dgc_pose.training.draw import Draw
from dgc_pose.training.views import MapPairs, Shape, level_known, level_truth

StageName = Literal["encoder", "decoders"]
Loss = tuple[Tensor, dict[str, Tensor]]  # with figures

# Shapes of the views in each stage's batches, in turn. All batches have about as many pixels.
SHAPES: dict[StageName, tuple[Shape, ...]] = {
    "encoder": ((224, 224), (208, 272), (272, 208), (352, 352), (160, 384)),
    "decoders": ((240, 240), (208, 272), (272, 208), (176, 336), (128, 448), (320, 176)),
}
_ROUNDS = 3  # of the consensus in the encoder's loss
# Target cells per pair
_QUERIES = 256  # at stride 4
_WINDOW_QUERIES = 160  # for the refinement
_LARGEST_SCALE = 60.0  # inverse temperature
# The losses ignore the features' length, so that it drifts; long features overflow half precision.
_LONGEST = 220.0
_DRIFT = 0.1
_ROBUST_CELLS = 4.0  # larger errors of a map count logarithmically
_LEAST_LOG = -14.0  # of a probability; limits the weight of a wrong truth
_RADIUS = 3  # cells of the engine's refinement
_SHARPNESS = 20.0  # inverse temperature of the engine's refinement
_JITTER = 1.5  # cells, of the window about the truth


class EncoderStage(nn.Module):
    """Trains the pyramid of a network for views of any shape, by the matches of its features.

    The losses are InfoNCE in both directions (at stride 16 with stride 8, after the consensus over
    both scales, and at strides 8 and 4) and the cross-entropy of the refinement at stride 4. Levels
    0 and 1 stay as they are.
    """

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        assert isinstance(net.pyramid, EfficientPyramid)
        self.net = net.requires_grad_(False)
        self.net.pyramid.requires_grad_(True)
        for level in (self.net.pyramid.level_0, self.net.pyramid.level_1):
            level.requires_grad_(False)
        scales = net.get_buffer("correlation_scales").log()
        # For the correlated levels, then for strides 8 and 4 on their own.
        self.log_scales = nn.Parameter(torch.cat([scales, scales.new_full((2,), 3)]))

    def forward(self, pairs: MapPairs, draw: Draw, progress: float) -> Loss:
        """The loss of a batch, and the shares of target cells with a right match."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        ratio = SECOND_SIZE / INPUT_SIZE
        size = [STRIDE * max(2, round(side * ratio / STRIDE)) for side in images.shape[2:]]
        small = F.interpolate(images, size, mode="bilinear", antialias=True)
        full = self._coarse(images)
        (s2, t2), (s3, t3), (s4, t4) = (l2_normalise(level).chunk(2) for level in full)
        _, (s3_small, t3_small), (s4_small, t4_small) = (
            l2_normalise(F.interpolate(low, level.shape[2:], mode="bilinear")).chunk(2)
            for low, level in zip(self._coarse(small), full, strict=True)
        )
        scales = self.log_scales.exp().clamp(max=_LARGEST_SCALE)
        evidence = match_evidence([s4, s3], [t4, t3], scales[:2])
        pooled = evidence  # `pooled_evidence` would match the full-sized images again
        for source, target in (([s4_small, s3_small], [t4, t3]), ([s4, s3], [t4_small, t3_small])):
            pooled = pooled.maximum(match_evidence(source, target, scales[:2]))
        grids = {4: _grid(s2), 8: _grid(s3), 16: _grid(s4)}
        truths = {}
        for stride, grid in grids.items():
            truth, valid = level_truth(pairs.map, pairs.valid, grid[0])
            truths[stride] = truth.flatten(1, 2), valid.flatten(1, 2)
        chosen, truth, valid = random_cells(*truths[4], _QUERIES, draw)
        truths[4] = truth, valid
        queries = t2.flatten(2).gather(2, chosen[:, None].expand(-1, t2.shape[1], -1))
        lengths = (level.norm(dim=1).mean() / _LONGEST - 1 for level in full[1:])
        total = 0.5 * window_loss(s2, t2, *truths[8], draw, _WINDOW_QUERIES)
        total = total + _DRIFT * sum(length.clamp(min=0) ** 2 for length in lengths)
        figures = {}
        for name, weight, stride, likely in (
            ("found16", 0.5, 16, match_scores(evidence) / 2),
            ("agreed16", 1.0, 16, consensus(match_scores(pooled), _ROUNDS, grids[16], grids[16])),
            ("found8", 1.0, 8, match_scores(_similarity(s3, t3.flatten(2), scales[2])) / 2),
            ("found4", 0.5, 4, match_scores(_similarity(s2, queries, scales[3])) / 2),
        ):
            part, figures[name] = likelihood_loss(likely, *truths[stride], stride, grids[stride])
            total = total + weight * part
        return total, figures

    def _coarse(self, images: Tensor) -> list[Tensor]:
        """Levels 2 to 4 of images, in single precision."""
        images = images.contiguous(memory_format=torch.channels_last)
        return [level.float().contiguous() for level in self.net.coarse_features(images)]

    def finished(self) -> DGCNet:
        """The network with the learnt inverse temperatures."""
        scales = self.log_scales.detach()[: len(CORRELATED)].exp()
        self.net.get_buffer("correlation_scales").copy_(scales.clamp(max=_LARGEST_SCALE))
        return self.net


class DecoderStage(nn.Module):
    """Trains all decoders at once on the frozen pyramid.

    In a network for views of any shape, each decoder gets its predecessor's detached map. A share
    of the pairs gets the true map plus smooth noise instead, so that the fine decoders learn before
    the coarse ones are good; this share falls over the stage. In the paper's networks nothing is
    detached, and the losses are the paper's. The two finest levels, which take the most time, are
    decoded on a random quarter of the view.
    """

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.net = net.requires_grad_(True)
        net.pyramid.requires_grad_(False)

    def train(self, mode: bool = True) -> DecoderStage:
        super().train(mode)
        self.net.pyramid.eval()
        return self

    def forward(self, pairs: MapPairs, draw: Draw, progress: float) -> Loss:
        """The map and mask losses of a batch, and each level's mean error in pixels."""
        shape = pairs.map.shape[1], pairs.map.shape[2]
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        with torch.no_grad():
            features = self.net.features(images.contiguous(memory_format=torch.channels_last))
        source, target = map(list, zip(*(level.chunk(2) for level in features), strict=True))
        own = self.net.config.any_shape
        share = max(0.0, 0.3 * (1 - 1.5 * progress)) if own else 0.0
        noisy = draw.chance(len(pairs.map), 1, 1, 1, share=share)
        corner = [draw.choice(range(side // 4 + 1)) for side in shape]
        state = self.net.start(source, target)
        total = state.new_zeros(())
        figures = {}
        for level in range(COARSEST, -1, -1):
            rows, columns = _window(level, shape, corner)
            side = shape[0] >> level
            parts = *level_truth(pairs.map, pairs.valid, side), level_known(pairs.known, side)
            # The truth for the decoded part of the level, in pixels of the views
            truth = MapPairs(*pairs[:2], *(part[:, rows, columns] for part in parts))
            if level < COARSEST:
                previous = upsample(state.detach() if own else state)
                if level == 1:
                    previous = previous[:, :, rows, columns]
                if share:
                    noised = self._noisy_truth(level, previous, truth, draw)
                    previous = torch.where(noisy, noised, previous)
                warped = self.net.warp(source[level], previous)
                seen = target[level][:, :, rows, columns]
                state = self.net.refine(level, warped, seen, previous, _grid(source[level]))
            part, figures[f"epe{LEVEL_SIZES[level]}"] = self._level_loss(level, state, truth)
            total = total + part
        if self.net.config.matchability == "network":
            total = total + mask_loss(self.net.mask(warped, seen), truth.valid, truth.known)
        return total, figures

    def _level_loss(self, level: int, state: Tensor, truth: MapPairs) -> tuple[Tensor, Tensor]:
        config = self.net.config
        size = _grid(truth.image1)[::-1]
        points = to_pixels(state[:, :2].movedim(1, -1), size, config.align_corners)
        # 0 elsewhere, so that undefined values of the truth do not reach the gradient.
        error = torch.where(truth.valid[..., None], points - truth.map, 0)
        distance = error.detach().norm(dim=-1)
        if config.any_shape:
            total = map_loss(error / 2**level, truth.valid)
        else:
            # |dx| + |dy| of normalised coordinates (paper, equation 3)
            normalised = 2 * error / error.new_tensor(size)
            total = masked_mean(normalised.abs().sum(-1), truth.valid)
        if config.matchability == "decoder":
            # Matchable: visible, with an error small enough for the next level (or, at the
            # finest level, for an estimator).
            good = truth.valid & (distance < max(4.0, 1.5 * 2**level))
            total = total + mask_loss(state[:, 2:], good, truth.known)
        return total, masked_mean(distance, truth.valid)

    def _noisy_truth(self, level: int, previous: Tensor, truth: MapPairs, draw: Draw) -> Tensor:
        """The true map plus smooth noise of up to two cells, with the previous mask channel.

        Where the truth is unknown, the previous map takes its place.
        """
        align_corners = self.net.config.align_corners
        size = _grid(truth.image1)[::-1]
        batch, _, *sides = previous.shape
        coarse = draw.normal(batch, 2, *(max(2, side // 4) for side in sides))
        smooth = F.interpolate(coarse, sides, mode="bicubic", align_corners=False)
        extent = draw.uniform(batch, 1, 1, 1, low=0.2, high=1.5)
        noise = (smooth * extent).movedim(1, -1) * 2**level
        points = to_pixels(previous.detach()[:, :2].movedim(1, -1), size, align_corners)
        noisy = torch.where(truth.known[..., None], truth.map, points) + noise
        bounded = noisy.clamp(-2 * max(size), 3 * max(size))
        noised = to_normalised(bounded, size, align_corners)
        return torch.cat([noised.movedim(-1, 1), previous[:, 2:].detach()], 1)

    def finished(self) -> DGCNet:
        return self.net


def _similarity(source: Tensor, target: Tensor, scale: Tensor) -> Tensor:
    """Scaled products (B, h * w, Q) of source cells (B, C, h, w), column-major, with (B, C, Q)."""
    return scale * source.transpose(2, 3).flatten(2).mT @ target


def _grid(features: Tensor) -> tuple[int, int]:
    return features.shape[2], features.shape[3]


def _window(level: int, shape: Shape, corner: list[int]) -> tuple[slice, slice]:
    """The decoded part of a level: all of it, or at the two finest levels half the rows and columns
    from `corner`, which is in cells of level 1."""
    if level > 1:
        return slice(None), slice(None)
    rows, columns = (
        slice(first << 1 - level, (first << 1 - level) + (side >> level + 1))
        for first, side in zip(corner, shape, strict=True)
    )
    return rows, columns


def masked_mean(values: Tensor, inside: Tensor) -> Tensor:
    """The mean of the `values` that are `inside`, even if others are NaN; 0 without any."""
    return torch.where(inside, values, 0).sum() / inside.sum().clamp(min=1)


def likelihood_loss(
    log_likely: Tensor, truth: Tensor, valid: Tensor, stride: int, grid: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """The mean negative log-likelihood of the true matches, and the share of right cells.

    log_likely: (B, h * w, Q), for source cells, column-major, and Q target cells; truth: (B, Q, 2),
    true points in source pixels, each divided bilinearly among the four cells around it; valid:
    (B, Q); grid: h and w. The best cell is right within 1.5 cells of the truth.
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
    source: Tensor, target: Tensor, truth: Tensor, valid: Tensor, draw: Draw, queries: int
) -> Tensor:
    """The cross-entropy of the refinement's soft-argmax, in a window around the truth.

    source, target: unit features (B, C, h, w) of stride 4. As in the engine, both are averaged over
    2x2 cells, in the source at stride 1. truth: true points (B, h w / 4, 2), pixels, of the
    target's cells of stride 8, of which `queries` random ones count; valid: (B, h w / 4).
    """
    means = F.avg_pool2d(source, 2, 1)
    wanted = F.avg_pool2d(target, 2).flatten(2)
    rows, columns = means.shape[2:]
    chosen, points, use = random_cells(truth, valid, queries, draw)
    place = torch.where(use[..., None], (points + 0.5) / 4 - 1, 0)  # in means, between cells
    middle = (place + _JITTER * draw.uniform(*place.shape, low=-1)).round()
    offsets = torch.arange(-_RADIUS, _RADIUS + 1, device=place.device)
    dy, dx = torch.meshgrid(offsets, offsets, indexing="ij")
    x = middle[..., :1] + dx.flatten()
    y = middle[..., 1:] + dy.flatten()
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


def random_cells(
    truth: Tensor, valid: Tensor, count: int, draw: Draw
) -> tuple[Tensor, Tensor, Tensor]:
    """Choose at most `count` random cells, valid ones first: their indices (B, n) in (B, N), true
    points (B, n, 2) and validity (B, n)."""
    order = draw.uniform(*valid.shape) + valid.float()
    chosen = order.topk(min(count, valid.shape[1]), 1).indices
    return chosen, truth.gather(1, chosen[..., None].expand(-1, -1, 2)), valid.gather(1, chosen)


def map_loss(error_cells: Tensor, valid: Tensor) -> Tensor:
    """Mean over valid cells of c log(1 + e / c), e = |dx| + |dy|.

    error_cells: (B, H, W, 2), in cells of the level. Large errors count less because a level cannot
    correct those of the level before.
    """
    error = error_cells.abs().sum(-1)
    return masked_mean(_ROBUST_CELLS * torch.log1p(error / _ROBUST_CELLS), valid)


def mask_loss(logits: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """Mean binary cross-entropy of matchability logits (B, 1, H, W) (paper, equation 4).

    target: (B, H, W) bool; only the cells that are `known` (B, H, W) count.
    """
    entropy = F.binary_cross_entropy_with_logits(logits[:, 0], target.to(logits), reduction="none")
    return masked_mean(entropy, known)
