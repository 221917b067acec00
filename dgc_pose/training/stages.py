"""The stages of a run: the encoder alone, then the decoders on the frozen encoder, then polish."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_normalised, to_pixels
from dgc_pose.network.correlation import l2_normalise
from dgc_pose.network.net import DGCNet, upsample
from dgc_pose.network.pyramid import Pyramid, fold_batch_norm
from dgc_pose.network.statistics import normalise
from dgc_pose.training.losses import contrastive_loss, level_truth, map_loss, mask_loss
from dgc_pose.training.pairs import TrainingPairs

_CONTRASTED = (COARSEST, 3, 2)  # levels that the contrastive loss runs on
_QUERIES = 400  # target cells a pair at level 2, where all would be thousands


class EncoderStage(nn.Module):
    """The pyramid with batch norm, trained contrastively at levels 4, 3 and 2.

    Trained so, an encoder is usable after minutes where the whole network end to end learns next
    to nothing; the inverse temperature of level 4 goes on into the correlation's soft-argmax.
    """

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.pyramid = Pyramid(replace(net.config, pyramid_batch_norm=True))
        for module in self.pyramid.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        self.log_scale = nn.Parameter(torch.full((len(_CONTRASTED),), 2.5))

    def loss(
        self, pairs: TrainingPairs, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """The contrastive loss of a batch, and the share of cells found at each level."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        features = self.pyramid(images.contiguous(memory_format=torch.channels_last))
        total = images.new_zeros(())
        shares = {}
        for index, level in enumerate(_CONTRASTED):
            source, target = l2_normalise(features[level]).chunk(2)
            stride = 2**level
            truth, valid = level_truth(pairs.map, pairs.valid, source.shape[-1])
            scale = self.log_scale[index].exp().clamp(max=60)
            queries = _QUERIES if level == 2 else None
            part, share = contrastive_loss(
                source, target, truth, valid, scale, stride, queries, generator
            )
            total = total + part
            shares[f"found{level}"] = float(share)
        return total, shares

    def write(self, net: DGCNet) -> None:
        """Put the trained pyramid, batch norm folded, and the temperature into the network."""
        fold_batch_norm(self.pyramid, net.pyramid)
        if net.config.soft_argmax:
            net.correlation_scale = self.log_scale[0].detach().exp().clamp(max=60).clone()


class DecoderStage(nn.Module):
    """All decoders at once on the frozen pyramid, each fed with its predecessor's detached map.

    A share of the pairs gets the true map plus smooth noise instead, so that the fine decoders
    learn before the coarse ones have; that share falls over the stage. The two finest levels are
    decoded on a random quarter of the view, where nearly all the time would go otherwise.
    """

    def __init__(
        self, net: DGCNet, end_to_end: bool = False, robust_cells: float | None = 4.0
    ) -> None:
        super().__init__()
        self.net = net
        self.end_to_end = end_to_end
        self.robust_cells = robust_cells

    def train(self, mode: bool = True) -> DecoderStage:
        super().train(mode)
        self.net.pyramid.eval()
        return self

    def trainable(self) -> list[nn.Parameter]:
        """Every parameter but the pyramid's."""
        frozen = {id(p) for p in self.net.pyramid.parameters()}
        return [p for p in self.net.parameters() if id(p) not in frozen]

    def loss(
        self, pairs: TrainingPairs, generator: torch.Generator, noise_share: float = 0.0
    ) -> tuple[Tensor, dict[str, float]]:
        """Map and mask losses of a batch of 240x240 pairs; each level's mean error in pixels."""
        with torch.no_grad():
            images = normalise(torch.cat([pairs.image1, pairs.image2]))
            features = self.net.pyramid(images.contiguous(memory_format=torch.channels_last))
        source = [f.chunk(2)[0] for f in features]
        target = [f.chunk(2)[1] for f in features]
        batch = len(pairs.map)
        noisy = torch.rand(batch, generator=generator).to(images) < noise_share
        offset = torch.randint(0, LEVEL_SIZES[1] // 2 + 1, (2,), generator=generator).tolist()
        state = self.net.coarsest(source[COARSEST], target[COARSEST])
        truth = _level_truth(COARSEST, pairs, _window(COARSEST, offset))
        total, error = self._level_loss(COARSEST, state, *truth)
        errors = {f"epe{LEVEL_SIZES[COARSEST]}": error}
        for level in range(COARSEST - 1, -1, -1):
            window = _window(level, offset)
            previous = upsample(state if self.end_to_end else state.detach())
            if level == 1:
                previous = previous[:, :, window[0], window[1]]
            truth = _level_truth(level, pairs, window)
            if noise_share > 0:
                noised = self._noisy_truth(level, previous, truth[0], generator)
                previous = torch.where(noisy[:, None, None, None], noised, previous)
            warped = self.net.warp(source[level], previous)
            seen = target[level][:, :, window[0], window[1]]
            state = self.net.refine(level, warped, seen, previous, window)
            part, error = self._level_loss(level, state, *truth)
            total = total + part
            errors[f"epe{LEVEL_SIZES[level]}"] = error
        if self.net.config.matchability == "network":
            logits = self.net.matchability_net(torch.cat([warped, seen], 1))
            total = total + mask_loss(logits, pairs.valid[:, window[0], window[1]])
        return total, errors

    def _level_loss(
        self, level: int, state: Tensor, truth: Tensor, valid: Tensor
    ) -> tuple[Tensor, float]:
        """The loss of a level's state, and its mean error in pixels."""
        stride = INPUT_SIZE // LEVEL_SIZES[level]
        config = self.net.config
        found = to_pixels(state[:, :2].movedim(1, -1), (INPUT_SIZE,) * 2, config.align_corners)
        error = found - truth
        total = map_loss(error / stride, valid, self.robust_cells)
        with torch.no_grad():
            distance = error.norm(dim=-1)
            mean = torch.where(valid, distance, 0).sum() / valid.sum().clamp(min=1)
        if config.matchability == "decoder":
            # A match is as good as its place: visible, and found to within what the next level
            # (or, at the end, an estimator) can use.
            good = valid & (distance < max(4.0, 1.5 * stride))
            total = total + mask_loss(state[:, 2:], good)
        return total, float(mean)

    def _noisy_truth(
        self, level: int, previous: Tensor, truth: Tensor, generator: torch.Generator
    ) -> Tensor:
        """The true map plus smooth noise of up to two cells, the mask channel as it was."""
        batch, height, width, _ = truth.shape
        coarse = torch.randn(batch, 2, height // 4, width // 4, generator=generator).to(truth)
        smooth = F.interpolate(coarse, (height, width), mode="bicubic", align_corners=False)
        size = 0.2 + 1.3 * torch.rand(batch, 1, 1, 1, generator=generator).to(truth)
        noise = (smooth * size).movedim(1, -1) * (INPUT_SIZE / LEVEL_SIZES[level])
        bounded = (truth + noise).clamp(-2 * INPUT_SIZE, 3 * INPUT_SIZE)
        place = to_normalised(bounded, (INPUT_SIZE,) * 2, self.net.config.align_corners)
        return torch.cat([place.movedim(-1, 1), previous[:, 2:].detach()], 1)


def _level_truth(
    level: int, pairs: TrainingPairs, window: tuple[slice, slice]
) -> tuple[Tensor, Tensor]:
    """The true map and where it holds, at the cells of a level that the window names."""
    truth, valid = level_truth(pairs.map, pairs.valid, LEVEL_SIZES[level])
    return truth[:, window[0], window[1]], valid[:, window[0], window[1]]


def _window(level: int, offset: list[int]) -> tuple[slice, slice]:
    """Rows and columns that a level is decoded on: all; at 120 and 240 the half from `offset`."""
    if level > 1:
        return slice(None), slice(None)
    scale = 2 if level == 0 else 1
    side = LEVEL_SIZES[level] // 2
    row, column = (scale * o for o in offset)
    return slice(row, row + side), slice(column, column + side)
