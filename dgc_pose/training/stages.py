"""The stages of a run: the encoder, its coarsest levels, the decoders on it, polish."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.errors import InputError
from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_normalised, to_pixels
from dgc_pose.network.correlation import cell_correlations, l2_normalise, match_evidence
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import Correlation, DGCNet, upsample
from dgc_pose.network.pyramid import Pyramid, fold_batch_norm
from dgc_pose.network.statistics import normalise
from dgc_pose.training.batch import TrainingPairs
from dgc_pose.training.draws import Draws
from dgc_pose.training.losses import (
    contrastive_loss,
    joint_mean,
    level_known,
    level_truth,
    map_loss,
    mask_loss,
)

Thawed = Literal["coarsest", "encoder"]
_ALONE = (3, 2)  # levels that the contrastive loss runs on beside the coarsest
_SCALE = 15.0  # inverse temperature of those, where it is not learned
_QUERIES = 400  # target cells a pair at level 2, where all would be thousands


@dataclass(frozen=True)
class Lesson:
    """What a teacher says of a batch of pairs, as a further target of the map."""

    map: Tensor  # (B, 240, 240, 2) pixels
    sure: Tensor  # (B, 240, 240) bool, where it is to be believed
    weight: float  # of the loss, beside that of the truth


class EncoderStage(nn.Module):
    """The pyramid, with batch norm where it has any, trained contrastively at levels 4, 3 and 2.

    Trained so, an encoder is usable after minutes where the whole network end to end learns next
    to nothing; the inverse temperatures of level 4's evidence go on into the soft-argmax.
    """

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.pyramid: Pyramid | EfficientPyramid
        if isinstance(net.pyramid, EfficientPyramid):
            # Its norms are folded for good: it goes on from trained weights.
            self.pyramid = deepcopy(net.pyramid)
            self.pyramid.thaw(len(_ALONE) + 1)
        else:
            self.pyramid = Pyramid(replace(net.config, pyramid_batch_norm=True))
            for module in self.pyramid.modules():
                if isinstance(module, nn.Conv2d):
                    nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        self.half_precision = net.half_precision
        # Of the levels that the coarsest's evidence is made of, then of those contrasted alone.
        self.correlated = net.config.correlated_levels
        self.log_scales = nn.Parameter(torch.full((self.correlated + len(_ALONE),), 2.5))

    def forward(
        self, pairs: TrainingPairs, draws: Draws
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The contrastive loss of a batch, and the share of cells found at each level.

        As all figures of the stages, they are this process's parts of the joint means.
        """
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.half_precision):
            coarse = self.pyramid.coarse(images.contiguous(memory_format=torch.channels_last))
        features = dict(enumerate(coarse, start=2))
        scales = self.log_scales.exp().clamp(max=60)
        levels = range(COARSEST, COARSEST - self.correlated, -1)
        halves = [l2_normalise(features[k].float()).chunk(2) for k in levels]
        correlations = cell_correlations(*zip(*halves, strict=True))
        evidence = match_evidence(correlations, scales[: self.correlated])
        total, share = _contrast_evidence(evidence, pairs)
        shares = {f"found{COARSEST}": share}
        for level, scale in zip(_ALONE, scales[self.correlated :], strict=True):
            part, share = _contrast(level, features[level], pairs, scale, draws)
            total = total + part
            shares[f"found{level}"] = share
        return total, shares

    def write(self, net: DGCNet) -> None:
        """Put the trained pyramid, batch norm folded, and the temperature into the network."""
        if isinstance(self.pyramid, EfficientPyramid):
            net.pyramid.load_state_dict(self.pyramid.state_dict())
        else:
            assert isinstance(net.pyramid, Pyramid)
            fold_batch_norm(self.pyramid, net.pyramid)
        if net.config.soft_argmax:
            scales = self.log_scales[: self.correlated].detach()
            net.correlation_scales = scales.exp().clamp(max=60).clone()


class CoarsestStage(nn.Module):
    """The encoder, or those levels of it that the correlation is made of, without any decoder.

    By the contrastive loss of the coarsest level, over whole views and with the neighbours heard.
    What goes wrong there no decoder mends, and a step takes half the time of one with decoders.
    Raises InputError for a network whose correlation is local.
    """

    def __init__(self, net: DGCNet, thawed: Thawed | None = "coarsest") -> None:
        super().__init__()
        if thawed is not None and net.config.correlation == "local":
            raise InputError(f"{net.config.name} has nothing to thaw: its correlation is local")
        self.net = net
        self.thawed = thawed
        net.requires_grad_(False)
        moving = {None: 0, "coarsest": net.config.correlated_levels, "encoder": len(LEVEL_SIZES)}
        net.pyramid.thaw(moving[thawed])

    def train(self, mode: bool = True) -> CoarsestStage:
        super().train(mode)
        self.net.pyramid.eval()
        return self

    def trainable(self) -> list[nn.Parameter]:
        """Every parameter but the frozen ones."""
        return [p for p in self.net.parameters() if p.requires_grad]

    def forward(
        self, pairs: TrainingPairs, draws: Draws
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The contrastive loss of a batch of 240x240 pairs, and the share of cells found."""
        source, target = self._features(pairs)
        return self._contrast(self.net.correlate(source, target), source, target, pairs, draws)

    def _features(self, pairs: TrainingPairs) -> tuple[list[Tensor], list[Tensor]]:
        """Those of the first images and of the second."""
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        features = self.net.features(images.contiguous(memory_format=torch.channels_last))
        halves = [f.chunk(2) for f in features]
        return [half[0] for half in halves], [half[1] for half in halves]

    def _contrast(
        self,
        correlation: Correlation,
        source: list[Tensor],
        target: list[Tensor],
        pairs: TrainingPairs,
        draws: Draws,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Of what is thawed: of the coarsest level, and of those that its loss does not reach.

        They would drift with the layers below them.
        """
        assert correlation.evidence is not None
        passes = self.net.config.consensus_passes
        total, found = _contrast_evidence(correlation.evidence, pairs, passes)
        shares = {f"found{COARSEST}": found}
        if self.thawed == "encoder":
            for level in _ALONE:
                both = torch.cat([source[level], target[level]])
                scale = both.new_tensor(_SCALE)
                part, shares[f"found{level}"] = _contrast(level, both, pairs, scale, draws)
                total = total + part
        return total, shares


class DecoderStage(CoarsestStage):
    """All decoders at once on the frozen pyramid, each fed with its predecessor's detached map.

    A share of the pairs gets the true map plus smooth noise instead, so that the fine decoders
    learn before the coarse ones have; that share falls over the stage. The two finest levels are
    decoded on a random quarter of the view, where nearly all the time would go otherwise.

    thawed: what of the encoder goes on learning too, as in `CoarsestStage`; the decoders' losses
    do not reach it.
    """

    def __init__(
        self,
        net: DGCNet,
        end_to_end: bool = False,
        robust_cells: float | None = 4.0,
        thawed: Thawed | None = None,
    ) -> None:
        super().__init__(net, thawed)
        for name, module in net.named_children():
            if name != "pyramid":
                module.requires_grad_(True)
        self.end_to_end = end_to_end
        self.robust_cells = robust_cells

    def forward(
        self,
        pairs: TrainingPairs,
        draws: Draws,
        noise_share: float = 0.0,
        lesson: Lesson | None = None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Map and mask losses of a batch of 240x240 pairs; each level's mean error in pixels."""
        source, target = self._features(pairs)
        correlation = self.net.correlate(source, target)
        total: Tensor = pairs.image1.new_zeros(())
        figures: dict[str, Tensor] = {}
        if self.thawed is not None:
            total, figures = self._contrast(correlation, source, target, pairs, draws)
        source, target = [f.detach() for f in source], [f.detach() for f in target]
        noisy = draws.uniform(len(pairs.map)) < noise_share
        offset = draws.integers(LEVEL_SIZES[1] // 2 + 1, 2)
        state = self.net.start(correlation.detached())
        part, error = self._level_loss(COARSEST, state, pairs, _window(COARSEST, offset), lesson)
        total = total + part
        figures[f"epe{LEVEL_SIZES[COARSEST]}"] = error
        for level in range(COARSEST - 1, -1, -1):
            window = _window(level, offset)
            previous = upsample(state if self.end_to_end else state.detach())
            if level == 1:
                previous = previous[:, :, window[0], window[1]]
            if noise_share > 0:
                noised = self._noisy_truth(level, previous, pairs, window, draws)
                previous = torch.where(noisy[:, None, None, None], noised, previous)
            warped = self.net.warp(source[level], previous)
            seen = target[level][:, :, window[0], window[1]]
            state = self.net.refine(level, warped, seen, previous, window)
            part, error = self._level_loss(level, state, pairs, window, lesson)
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
        pairs: TrainingPairs,
        window: tuple[slice, slice],
        lesson: Lesson | None,
    ) -> tuple[Tensor, Tensor]:
        """The loss of a level's state, and its mean error in pixels."""
        config = self.net.config
        stride = INPUT_SIZE // LEVEL_SIZES[level]
        found = to_pixels(state[:, :2].movedim(1, -1), (INPUT_SIZE,) * 2, config.align_corners)
        error, valid = _error(level, found, pairs.map, pairs.valid, window)
        total = map_loss(error / stride, valid, self.robust_cells)
        if lesson is not None:
            off, sure = _error(level, found, lesson.map, lesson.sure, window)
            total = total + lesson.weight * map_loss(off / stride, sure, self.robust_cells)
        distance = error.detach().norm(dim=-1)
        if config.matchability == "decoder":
            # A match is as good as its place: visible, and found to within what the next level
            # (or, at the end, an estimator) can use.
            good = valid & (distance < max(4.0, 1.5 * stride))
            known = level_known(pairs.known, LEVEL_SIZES[level])[:, window[0], window[1]]
            total = total + mask_loss(state[:, 2:], good, known)
        return total, joint_mean(distance, valid)

    def _noisy_truth(
        self,
        level: int,
        previous: Tensor,
        pairs: TrainingPairs,
        window: tuple[slice, slice],
        draws: Draws,
    ) -> Tensor:
        """The true map plus smooth noise of up to two cells, the mask channel as it was.

        Where the truth is not known, the previous map plus that noise.
        """
        config = self.net.config
        size = (INPUT_SIZE, INPUT_SIZE)
        batch, _, height, width = previous.shape
        coarse = draws.normal(batch, 2, height // 4, width // 4)
        smooth = F.interpolate(coarse, (height, width), mode="bicubic", align_corners=False)
        extent = 0.2 + 1.3 * draws.uniform(batch, 1, 1, 1)
        noise = (smooth * extent).movedim(1, -1) * (INPUT_SIZE / LEVEL_SIZES[level])
        rows, columns = window
        cells = LEVEL_SIZES[level]
        truth = level_truth(pairs.map, pairs.valid, cells)[0][:, rows, columns]
        known = level_known(pairs.known, cells)[:, rows, columns, None]
        place = to_pixels(previous.detach()[:, :2].movedim(1, -1), size, config.align_corners)
        bounded = (torch.where(known, truth, place) + noise).clamp(-2 * INPUT_SIZE, 3 * INPUT_SIZE)
        place = to_normalised(bounded, size, config.align_corners)
        return torch.cat([place.movedim(-1, 1), previous[:, 2:].detach()], 1)


def _contrast_evidence(
    evidence: Tensor, pairs: TrainingPairs, passes: int = 0
) -> tuple[Tensor, Tensor]:
    """The contrastive loss of the coarsest level's evidence, and the share of its cells found."""
    truth, valid = level_truth(pairs.map, pairs.valid, evidence.shape[-1])
    logits, stride = evidence.flatten(2), 2**COARSEST
    return contrastive_loss(logits, truth.flatten(1, 2), valid.flatten(1), stride, passes)


def _contrast(
    level: int, features: Tensor, pairs: TrainingPairs, scale: Tensor, draws: Draws
) -> tuple[Tensor, Tensor]:
    """The contrastive loss of a level alone, and the share of its cells found.

    features: (2B, C, n, n). At level 2 some random target cells stand for all.
    """
    source, target = l2_normalise(features.float()).chunk(2)
    truth, valid = level_truth(pairs.map, pairs.valid, source.shape[-1])
    truth, valid = truth.flatten(1, 2), valid.flatten(1)
    columns, target = source.transpose(2, 3).flatten(2), target.flatten(2)
    batch, channels, count = target.shape
    if level == 2 and count > _QUERIES:
        chosen = draws.uniform(batch, count).topk(_QUERIES, 1).indices
        target = target.gather(2, chosen[:, None].expand(-1, channels, -1))
        truth = truth.gather(1, chosen[..., None].expand(-1, -1, 2))
        valid = valid.gather(1, chosen)
    logits = torch.bmm(columns.transpose(1, 2), target) * scale
    return contrastive_loss(logits, truth, valid, 2**level)


def _error(
    level: int, found: Tensor, truth: Tensor, valid: Tensor, window: tuple[slice, slice]
) -> tuple[Tensor, Tensor]:
    """Of a level's places (B, H, W, 2): what they are off by, pixels, and where that counts.

    It is 0 elsewhere: what stands there in `truth` must reach no gradient.
    """
    truth, valid = level_truth(truth, valid, LEVEL_SIZES[level])
    truth, valid = truth[:, window[0], window[1]], valid[:, window[0], window[1]]
    return torch.where(valid[..., None], found - truth, 0), valid


def _window(level: int, offset: list[int]) -> tuple[slice, slice]:
    """Rows and columns that a level is decoded on: all; at 120 and 240 the half from `offset`."""
    if level > 1:
        return slice(None), slice(None)
    scale = 2 if level == 0 else 1
    side = LEVEL_SIZES[level] // 2
    row, column = (scale * o for o in offset)
    return slice(row, row + side), slice(column, column + side)
