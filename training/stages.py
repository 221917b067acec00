"""The stages of a run: the encoder, the decoders, the decoders end to end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import deepcopy

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_normalised, to_pixels
from dgc_pose.network.correlation import match_evidence
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet, l2_normalise, normalise, upsample
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.training.losses import contrastive_loss, map_loss, mask_loss, masked_mean
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import MapPairs, level_known, level_truth

_CONTRASTED = (3, 2)  # levels with a contrastive loss of their own, beside the coarsest
_QUERIES = 400  # target cells a pair at level 2, which has thousands
_SIZE = (INPUT_SIZE, INPUT_SIZE)

Window = tuple[slice, slice]  # rows and columns of a level
Loss = tuple[Tensor, dict[str, Tensor]]  # with figures


class EncoderStage(nn.Module):
    """The pyramid, trained contrastively at levels 4, 3 and 2.

    An encoder trained so is usable after minutes; trained end to end, it learns next to nothing in
    that time. The soft-argmax takes over the inverse temperatures of level 4.

    A `Pyramid` starts from random weights, with batch norm. An `EfficientPyramid`, whose norms are
    folded, starts from the network's weights; its levels 0 and 1 are left as they are.

    trained: the network's inverse temperatures are trained ones, to start from.
    """

    def __init__(self, net: DGCNet, trained: bool = False) -> None:
        super().__init__()
        self.pyramid: Pyramid | EfficientPyramid
        if isinstance(net.pyramid, EfficientPyramid):
            self.pyramid = deepcopy(net.pyramid)
            self.pyramid.requires_grad_(True)
            for level in (self.pyramid.level_0, self.pyramid.level_1):
                level.requires_grad_(False)
        else:
            self.pyramid = Pyramid(net.config, batch_norm=True)
            for module in self.pyramid.modules():
                if isinstance(module, nn.Conv2d):
                    nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        self.half_precision = net.half_precision
        # Of the correlated levels, then of those with a contrastive loss of their own.
        self.correlated = net.config.correlated
        count = len(self.correlated) + len(_CONTRASTED)
        self.log_scales = nn.Parameter(torch.full((count,), 2.5))
        if trained:
            scales = net.get_buffer("correlation_scales").log()
            self.log_scales.data[:] = scales[0]
            self.log_scales.data[: len(scales)] = scales

    def forward(self, pairs: MapPairs, draw: Draw) -> Loss:
        """The contrastive loss of a batch, and the share of cells found at each level."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.half_precision):
            coarse = self.pyramid.coarse(images.contiguous(memory_format=torch.channels_last))
        features = dict(enumerate(coarse, start=2))
        scales = self.log_scales.exp().clamp(max=60)
        halves = [l2_normalise(features[k].float()).chunk(2) for k in self.correlated]
        source, target = zip(*halves, strict=True)
        evidence = match_evidence(source, target, scales[: len(self.correlated)])
        contrasted = {level: features[level] for level in _CONTRASTED}
        return _contrast(evidence, contrasted, scales[len(self.correlated) :], pairs, draw)

    def write(self, net: DGCNet) -> None:
        """Copy the trained pyramid, batch norm folded, and the temperatures into the network."""
        if isinstance(self.pyramid, EfficientPyramid):
            net.pyramid.load_state_dict(self.pyramid.state_dict())
        else:
            assert isinstance(net.pyramid, Pyramid)
            fold_batch_norm(self.pyramid, net.pyramid)
        if net.config.any_shape:
            scales = self.log_scales[: len(self.correlated)].detach()
            net.correlation_scales = scales.exp().clamp(max=60).clone()


def fold_batch_norm(trained: Pyramid, plain: Pyramid) -> None:
    """Load a pyramid trained with batch norm into one without, which then gives the same features.

    VGG without batch norm does not learn from random weights; with it, folded afterwards, it does.
    """
    convolutions = [m for m in plain.modules() if isinstance(m, nn.Conv2d)]
    modules = [m for m in trained.modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    was_training = trained.training
    trained.eval()
    pairs = zip(modules[::2], modules[1::2], strict=True)
    for target, (convolution, norm) in zip(convolutions, pairs, strict=True):
        assert isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)
        target.load_state_dict(fuse_conv_bn_eval(convolution, norm).state_dict())
    trained.train(was_training)


class DecoderStage(nn.Module):
    """All decoders at once on the frozen pyramid, each fed with its predecessor's detached map.

    A share of the pairs gets the true map plus smooth noise instead, so that the fine decoders
    learn before the coarse ones have; that share falls over the stage. The two finest levels,
    which cost the most time, are decoded on a random quarter of the view.

    end_to_end: maps are not detached (the polish stage).
    """

    def __init__(self, net: DGCNet, end_to_end: bool = False) -> None:
        super().__init__()
        self.net = net.requires_grad_(True)
        net.pyramid.requires_grad_(False)
        self.end_to_end = end_to_end

    def train(self, mode: bool = True) -> DecoderStage:
        super().train(mode)
        self.net.pyramid.eval()
        return self

    def forward(self, pairs: MapPairs, draw: Draw, noise_share: float = 0.0) -> Loss:
        """Map and mask losses of a batch of 240x240 pairs; each level's mean error in pixels."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        features = self.net.features(images.contiguous(memory_format=torch.channels_last))
        halves = [feature.chunk(2) for feature in features]
        source, target = [half[0] for half in halves], [half[1] for half in halves]
        correlation = self.net.correlate(source, target)
        noisy = draw.chance(len(pairs.map), share=noise_share)
        offset = draw.numbers(2, LEVEL_SIZES[1] // 2 + 1)
        state = self.net.start(correlation, source[COARSEST], target[COARSEST])
        total, error = self._level_loss(COARSEST, state, pairs, _window(COARSEST, offset))
        figures = {f"epe{LEVEL_SIZES[COARSEST]}": error}
        for level in range(COARSEST - 1, -1, -1):
            window = _window(level, offset)
            previous = upsample(state if self.end_to_end else state.detach())
            if level == 1:
                previous = previous[:, :, window[0], window[1]]
            if noise_share > 0:
                noised = self._noisy_truth(level, previous, pairs, window, draw)
                previous = torch.where(noisy[:, None, None, None], noised, previous)
            warped = self.net.warp(source[level], previous)
            seen = target[level][:, :, window[0], window[1]]
            state = self.net.refine(level, warped, seen, previous, window)
            part, error = self._level_loss(level, state, pairs, window)
            total = total + part
            figures[f"epe{LEVEL_SIZES[level]}"] = error
        if self.net.config.matchability == "network":
            rows, columns = window
            seen_valid, known = pairs.valid[:, rows, columns], pairs.known[:, rows, columns]
            total = total + mask_loss(self.net.mask(warped, seen), seen_valid, known)
        return total, figures

    def _level_loss(
        self,
        level: int,
        state: Tensor,
        pairs: MapPairs,
        window: Window,
    ) -> tuple[Tensor, Tensor]:
        """The loss of a level's state, and its mean error in pixels."""
        config = self.net.config
        stride = INPUT_SIZE // LEVEL_SIZES[level]
        points = to_pixels(state[:, :2].movedim(1, -1), _SIZE, config.align_corners)
        truth, valid = level_truth(pairs.map, pairs.valid, LEVEL_SIZES[level])
        truth, valid = truth[:, window[0], window[1]], valid[:, window[0], window[1]]
        # 0 elsewhere, so that undefined values of the truth reach no gradient.
        error = torch.where(valid[..., None], points - truth, 0)
        total = map_loss(error / stride, valid)
        distance = error.detach().norm(dim=-1)
        if config.matchability == "decoder":
            # Matchable: visible, with an error that the next level (or, at the finest, an
            # estimator) can use.
            good = valid & (distance < max(4.0, 1.5 * stride))
            known = level_known(pairs.known, LEVEL_SIZES[level])[:, window[0], window[1]]
            total = total + mask_loss(state[:, 2:], good, known)
        return total, masked_mean(distance, valid)

    def _noisy_truth(
        self,
        level: int,
        previous: Tensor,
        pairs: MapPairs,
        window: Window,
        draw: Draw,
    ) -> Tensor:
        """The true map plus smooth noise of up to two cells, with the previous mask channel.

        The previous map plus that noise for cells of unknown truth.
        """
        config = self.net.config
        batch, _, height, width = previous.shape
        coarse = draw.normal(batch, 2, height // 4, width // 4)
        smooth = F.interpolate(coarse, (height, width), mode="bicubic", align_corners=False)
        extent = 0.2 + 1.3 * draw.uniform(batch, 1, 1, 1)
        noise = (smooth * extent).movedim(1, -1) * (INPUT_SIZE / LEVEL_SIZES[level])
        rows, columns = window
        cells = LEVEL_SIZES[level]
        truth = level_truth(pairs.map, pairs.valid, cells)[0][:, rows, columns]
        known = level_known(pairs.known, cells)[:, rows, columns, None]
        points = to_pixels(previous.detach()[:, :2].movedim(1, -1), _SIZE, config.align_corners)
        bounded = (torch.where(known, truth, points) + noise).clamp(-2 * INPUT_SIZE, 3 * INPUT_SIZE)
        noised = to_normalised(bounded, _SIZE, config.align_corners)
        return torch.cat([noised.movedim(-1, 1), previous[:, 2:].detach()], 1)


def _contrast(
    evidence: Tensor,
    features: Mapping[int, Tensor],
    scales: Tensor,
    pairs: MapPairs,
    draw: Draw,
) -> Loss:
    """The contrastive loss of the coarsest level's evidence, and of other levels alone.

    features: (2B, C, n, n) of these levels, each with its inverse temperature. The figures are the
    shares of cells whose match is right.
    """
    cells = math.isqrt(evidence.shape[-1])
    truth, valid = level_truth(pairs.map, pairs.valid, cells)
    total, share = contrastive_loss(evidence, truth.flatten(1, 2), valid.flatten(1), 2**COARSEST)
    shares = {f"found{COARSEST}": share}
    for (level, values), scale in zip(features.items(), scales, strict=True):
        part, share = _level_contrast(level, values, pairs, scale, draw)
        total = total + part
        shares[f"found{level}"] = share
    return total, shares


def _level_contrast(
    level: int, features: Tensor, pairs: MapPairs, scale: Tensor, draw: Draw
) -> tuple[Tensor, Tensor]:
    """The contrastive loss of a level alone, and the share of its cells whose match is right.

    features: (2B, C, n, n). Level 2 takes a random sample of the target cells.
    """
    source, target = l2_normalise(features.float()).chunk(2)
    truth, valid = level_truth(pairs.map, pairs.valid, source.shape[-1])
    truth, valid = truth.flatten(1, 2), valid.flatten(1)
    columns, target = source.transpose(2, 3).flatten(2), target.flatten(2)
    batch, channels, count = target.shape
    if level == 2 and count > _QUERIES:
        chosen = draw.uniform(batch, count).topk(_QUERIES, 1).indices
        target = target.gather(2, chosen[:, None].expand(-1, channels, -1))
        truth = truth.gather(1, chosen[..., None].expand(-1, -1, 2))
        valid = valid.gather(1, chosen)
    logits = torch.bmm(columns.transpose(1, 2), target) * scale
    return contrastive_loss(logits, truth, valid, 2**level)


def _window(level: int, offset: list[int]) -> Window:
    """The part of a level that is decoded: all; at 120 and 240 cells the half from `offset`."""
    if level > 1:
        return slice(None), slice(None)
    scale = 2 if level == 0 else 1
    side = LEVEL_SIZES[level] // 2
    row, column = (scale * o for o in offset)
    return slice(row, row + side), slice(column, column + side)
