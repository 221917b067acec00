"""The stages of a run: the encoder, then the decoders on it."""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES, SECOND_SIZE, STRIDE
from dgc_pose.network.coordinates import to_normalised, to_pixels
from dgc_pose.network.correlation import consensus, match_evidence, match_scores
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet, l2_normalise, normalise, upsample
from dgc_pose.training.draw import Draw
from dgc_pose.training.losses import (
    absolute_map_loss,
    likelihood_loss,
    map_loss,
    mask_loss,
    masked_mean,
    random_cells,
    window_loss,
)
from dgc_pose.training.map_pairs import MapPairs, level_known, level_truth
from dgc_pose.training.views import Shape

StageName = Literal["encoder", "decoders"]
Loss = tuple[Tensor, dict[str, Tensor]]  # with figures
Window = tuple[slice, slice]  # rows and columns of a level

# Views of each stage's batches in turn. One batch has as many pixels as the next.
SHAPES: dict[StageName, tuple[Shape, ...]] = {
    "encoder": ((224, 224), (208, 272), (272, 208), (352, 352), (160, 384)),
    "decoders": ((240, 240), (208, 272), (272, 208), (176, 336), (128, 448), (320, 176)),
}
_ROUNDS = 3  # of the consensus that the encoder is trained through
_QUERIES, _WINDOW_QUERIES = 256, 160  # target cells a pair, of stride 4 and for the refinement
_LARGEST_SCALE = 60.0  # inverse temperature
# Features are compared without their length, which drifts; long ones overflow half precision.
_LONGEST, _DRIFT = 220.0, 0.1


class EncoderStage(nn.Module):
    """The pyramid of a network of views of any shape, by the matches of its features.

    InfoNCE, in both directions, at stride 16 with stride 8, through the consensus over both scales,
    at strides 8 and 4; and the cross-entropy of the refinement at stride 4. Levels 0 and 1 stay.
    """

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        assert isinstance(net.pyramid, EfficientPyramid)
        self.net = net.requires_grad_(False)
        self.net.pyramid.requires_grad_(True)
        for level in (self.net.pyramid.level_0, self.net.pyramid.level_1):
            level.requires_grad_(False)
        scales = net.get_buffer("correlation_scales").log()
        # Of the correlated levels, then of strides 8 and 4 alone.
        self.log_scales = nn.Parameter(
            torch.cat([scales, torch.full_like(scales[:1], 3).repeat(2)])
        )

    def forward(self, pairs: MapPairs, draw: Draw, progress: float) -> Loss:
        """The loss of a batch, and the shares of cells found."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        ratio = SECOND_SIZE / INPUT_SIZE
        size = [STRIDE * max(2, round(side * ratio / STRIDE)) for side in images.shape[2:]]
        small = F.interpolate(images, size, mode="bilinear", antialias=True)
        full = self._coarse(images)
        resampled = [
            F.interpolate(low, level.shape[2:], mode="bilinear")
            for low, level in zip(self._coarse(small), full, strict=True)
        ]
        length = sum(
            (level.norm(dim=1).mean() / _LONGEST - 1).clamp(min=0) ** 2 for level in full[1:]
        )
        (s2, t2), (s3, t3), (s4, t4) = (l2_normalise(level).chunk(2) for level in full)
        _, (s3_small, t3_small), (s4_small, t4_small) = (
            l2_normalise(level).chunk(2) for level in resampled
        )
        scales = self.log_scales.exp().clamp(max=_LARGEST_SCALE)
        evidence = match_evidence([s4, s3], [t4, t3], scales[:2])
        pooled = evidence
        for source, target in (([s4_small, s3_small], [t4, t3]), ([s4, s3], [t4_small, t3_small])):
            pooled = pooled.maximum(match_evidence(source, target, scales[:2]))
        grids = {4: _grid(s2), 8: _grid(s3), 16: _grid(s4)}
        truths = {
            stride: _flat(*level_truth(pairs.map, pairs.valid, grid[0]))
            for stride, grid in grids.items()
        }
        chosen = random_cells(truths[4][1], _QUERIES, draw)
        place = truths[4][0].gather(1, chosen[..., None].expand(-1, -1, 2))
        truths[4] = place, truths[4][1].gather(1, chosen)
        queries = t2.flatten(2).gather(2, chosen[:, None].expand(-1, t2.shape[1], -1))
        total = 0.5 * window_loss(s2, t2, truths[8], draw, _WINDOW_QUERIES) + _DRIFT * length
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
        """Levels 2 to 4, in single precision."""
        images = images.contiguous(memory_format=torch.channels_last)
        return [level.float().contiguous() for level in self.net.coarse_features(images)]

    def finished(self) -> DGCNet:
        """The network with the inverse temperatures that were learnt."""
        scales = self.log_scales.detach()[: len(self.net.config.correlated)].exp()
        self.net.get_buffer("correlation_scales").copy_(scales.clamp(max=_LARGEST_SCALE))
        return self.net


class DecoderStage(nn.Module):
    """All decoders at once on the frozen pyramid.

    For views of any shape each is fed with its predecessor's detached map, and a share of the pairs
    gets the true map plus smooth noise instead, so that the fine decoders learn before the coarse
    ones have; that share falls over the stage. For the paper's networks nothing is detached, and
    the losses are the paper's. The two finest levels, which cost the most time, are decoded on a
    random quarter of the view.
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
        """Map and mask losses of a batch; each level's mean error in pixels."""
        shape = pairs.map.shape[1], pairs.map.shape[2]
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        with torch.no_grad():
            features = self.net.features(images.contiguous(memory_format=torch.channels_last))
        halves = [feature.chunk(2) for feature in features]
        source, target = [half[0] for half in halves], [half[1] for half in halves]
        own = self.net.config.any_shape
        share = max(0.0, 0.3 * (1 - 1.5 * progress)) if own else 0.0
        noisy = draw.chance(len(pairs.map), 1, 1, 1, share=share)
        corner = [draw.choice(range(side // 4 + 1)) for side in shape]
        state = self.net.start(
            self.net.correlate(source, target), source[COARSEST], target[COARSEST]
        )
        window = _window(COARSEST, shape, corner)
        total, error = self._level_loss(COARSEST, state, pairs, window)
        figures = {f"epe{LEVEL_SIZES[COARSEST]}": error}
        for level in range(COARSEST - 1, -1, -1):
            window = _window(level, shape, corner)
            previous = upsample(state.detach() if own else state)
            if level == 1:
                previous = previous[:, :, window[0], window[1]]
            if share:
                noised = self._noisy_truth(level, previous, pairs, window, draw)
                previous = torch.where(noisy, noised, previous)
            warped = self.net.warp(source[level], previous)
            seen = target[level][:, :, window[0], window[1]]
            state = self.net.refine(level, warped, seen, previous, window, _grid(source[level]))
            part, error = self._level_loss(level, state, pairs, window)
            total = total + part
            figures[f"epe{LEVEL_SIZES[level]}"] = error
        if self.net.config.matchability == "network":
            rows, columns = window
            valid, known = pairs.valid[:, rows, columns], pairs.known[:, rows, columns]
            total = total + mask_loss(self.net.mask(warped, seen), valid, known)
        return total, figures

    def _level_loss(
        self, level: int, state: Tensor, pairs: MapPairs, window: Window
    ) -> tuple[Tensor, Tensor]:
        """The loss of a level's state, and its mean error in pixels."""
        config = self.net.config
        rows, size = pairs.map.shape[1] >> level, (pairs.map.shape[2], pairs.map.shape[1])
        truth, valid = level_truth(pairs.map, pairs.valid, rows)
        truth, valid = truth[:, window[0], window[1]], valid[:, window[0], window[1]]
        points = to_pixels(state[:, :2].movedim(1, -1), size, config.align_corners)
        # 0 elsewhere, so that undefined values of the truth reach no gradient.
        error = torch.where(valid[..., None], points - truth, 0)
        distance = error.detach().norm(dim=-1)
        if config.any_shape:
            total = map_loss(error / 2**level, valid)
        else:
            total = absolute_map_loss(2 * error / error.new_tensor(size), valid)
        if config.matchability == "decoder":
            # Matchable: visible, with an error that the next level (or, at the finest, an
            # estimator) can use.
            good = valid & (distance < max(4.0, 1.5 * 2**level))
            known = level_known(pairs.known, rows)[:, window[0], window[1]]
            total = total + mask_loss(state[:, 2:], good, known)
        return total, masked_mean(distance, valid)

    def _noisy_truth(
        self, level: int, previous: Tensor, pairs: MapPairs, window: Window, draw: Draw
    ) -> Tensor:
        """The true map plus smooth noise of up to two cells, with the previous mask channel.

        The previous map plus that noise for cells of unknown truth.
        """
        config = self.net.config
        batch, _, height, width = previous.shape
        rows, size = pairs.map.shape[1] >> level, (pairs.map.shape[2], pairs.map.shape[1])
        coarse = draw.normal(batch, 2, max(2, height // 4), max(2, width // 4))
        smooth = F.interpolate(coarse, (height, width), mode="bicubic", align_corners=False)
        extent = draw.uniform(batch, 1, 1, 1, low=0.2, high=1.5)
        noise = (smooth * extent).movedim(1, -1) * 2**level
        truth = level_truth(pairs.map, pairs.valid, rows)[0][:, window[0], window[1]]
        known = level_known(pairs.known, rows)[:, window[0], window[1], None]
        points = to_pixels(previous.detach()[:, :2].movedim(1, -1), size, config.align_corners)
        bounded = (torch.where(known, truth, points) + noise).clamp(-2 * max(size), 3 * max(size))
        noised = to_normalised(bounded, size, config.align_corners)
        return torch.cat([noised.movedim(-1, 1), previous[:, 2:].detach()], 1)

    def finished(self) -> DGCNet:
        """The network with its decoders."""
        return self.net


def _flat(truth: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Cells (B, h, w, 2) and (B, h, w) in one row."""
    return truth.flatten(1, 2), valid.flatten(1, 2)


def _similarity(source: Tensor, target: Tensor, scale: Tensor) -> Tensor:
    """Scaled products (B, h * w, Q) of source cells (B, C, h, w), column-major, and (B, C, Q)."""
    return scale * source.transpose(2, 3).flatten(2).mT @ target


def _grid(features: Tensor) -> tuple[int, int]:
    return features.shape[2], features.shape[3]


def _window(level: int, shape: Shape, corner: list[int]) -> Window:
    """The part of a level that is decoded: all; of the two finest the half from `corner`, rows and
    columns of level 1."""
    if level > 1:
        return slice(None), slice(None)
    rows, columns = (
        slice(first << 1 - level, (first << 1 - level) + (side >> level + 1))
        for first, side in zip(corner, shape, strict=True)
    )
    return rows, columns
