"""Validation on fixed pairs of photographs that train nothing."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.training.losses import level_truth
from dgc_pose.training.pairs import PairOptions, TrainingPairs, make_pairs
from dgc_pose.training.photos import Photos

_SEED = 20190108  # of the validation pairs, whatever a run's own seed


def validation_pairs(
    photos: Photos, pairs: int, batch: int, options: PairOptions
) -> list[TrainingPairs]:
    """The same pairs for every run: batches of 240x240 from the held-back photographs."""
    generator = torch.Generator().manual_seed(_SEED)
    return [
        make_pairs(photos, batch, INPUT_SIZE, generator, options)
        for _ in range(max(1, pairs // batch))
    ]


@torch.no_grad()
def validate(net: DGCNet, batches: Iterable[TrainingPairs]) -> dict[str, float]:
    """Figures over the pairs, in pixels of 240.

    `aepe` (over valid pixels, mean of a pair, then over pairs), `epe_median` (of all valid
    pixels), `pck3` (share of valid pixels within 3 px), `sure3` (the same over pixels that the net
    gives matchability above one half), `jaccard` of the mask, and each level's `aepe15` to
    `aepe240`. The last two need decoders; the mask's figures are NaN for a net without one.
    """
    was_training = net.training
    net.eval()
    per_level: list[list[float]] = [[] for _ in LEVEL_SIZES]
    errors, sure_errors = [], []
    both = either = 0
    for pairs in batches:
        prediction = net(normalise(pairs.image1), normalise(pairs.image2))
        for index, level in enumerate(range(COARSEST, -1, -1)):
            truth, valid = level_truth(pairs.map, pairs.valid, LEVEL_SIZES[level])
            found = to_pixels(
                prediction.maps[index].movedim(1, -1),
                (INPUT_SIZE, INPUT_SIZE),
                net.config.align_corners,
            )
            distance = (found - truth).norm(dim=-1)
            total = torch.where(valid, distance, 0).flatten(1).sum(1)
            count = valid.flatten(1).sum(1)
            per_level[level] += (total / count)[count > 0].tolist()
        errors.append(distance[valid])
        if prediction.logits:
            mask = prediction.logits[-1][:, 0] > 0
            both += int((mask & valid).sum())
            either += int((mask | valid).sum())
            sure_errors.append(torch.where(valid, distance, torch.inf)[mask])
    net.train(was_training)
    figures = {
        "aepe": _mean(per_level[0]),
        "epe_median": float(torch.cat(errors).median()),
        "pck3": _within(3.0, errors),
        "sure3": _within(3.0, sure_errors),
        "jaccard": both / either if either else float("nan"),
    }
    levels = zip(LEVEL_SIZES[::-1], per_level[::-1], strict=True)
    return figures | {f"aepe{cells}": _mean(values) for cells, values in levels}


def _within(pixels: float, errors: list[Tensor]) -> float:
    return float((torch.cat(errors) < pixels).float().mean()) if errors else float("nan")


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else float("nan")
