"""Validation on fixed pairs of photographs that train nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dgc_pose.metrics import aepe, endpoint_errors, jaccard
from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.training.batch import TrainingPairs
from dgc_pose.training.losses import level_truth
from dgc_pose.training.pairs import PairOptions, make_pairs
from dgc_pose.training.photos import Photos

_SEED = 20190108  # of the validation pairs, whatever a run's own seed


@dataclass(frozen=True, eq=False)
class LevelMap:
    """A level's map of one pair beside the truth, in pixels of the 240x240 input."""

    found: np.ndarray  # (S, S, 2) float32, for each cell of the target its place in the source
    truth: np.ndarray  # (S, S, 2) float32
    valid: np.ndarray  # (S, S) bool, where the truth holds

    @property
    def aepe(self) -> float:
        """Mean Euclidean error over the valid cells, pixels; NaN where there are none."""
        return aepe(self.found, self.truth, self.valid)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a network says of one pair, beside the truth."""

    levels: tuple[LevelMap, ...]  # coarse to fine, 15 to 240 cells a side
    matchability: np.ndarray | None  # (240, 240) float32 in [0, 1]; None for a net without a mask
    known: np.ndarray  # (240, 240) bool, where it is known whether there is something to find

    @property
    def finest(self) -> LevelMap:
        return self.levels[-1]

    @property
    def errors(self) -> np.ndarray:
        """Euclidean error (240, 240) of every pixel; infinite where there is nothing to find."""
        distance = np.full(self.finest.valid.shape, np.inf)
        finest = self.finest
        distance[finest.valid] = endpoint_errors(finest.found, finest.truth, finest.valid)
        return distance

    @property
    def mask(self) -> np.ndarray | None:
        """(240, 240) bool, where the matchability is above one half."""
        return None if self.matchability is None else self.matchability > 0.5


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
def compare(net: DGCNet, pairs: TrainingPairs) -> list[Comparison]:
    """The net's bare forward pass on a batch of 240x240 pairs, pair by pair beside the truth.

    The net is taken in evaluation mode and left in the mode it came in.
    """
    was_training = net.training
    net.eval()
    images = [
        normalise(image).contiguous(memory_format=torch.channels_last)
        for image in (pairs.image1, pairs.image2)
    ]
    prediction = net(*images)
    net.train(was_training)
    size = (INPUT_SIZE, INPUT_SIZE)
    levels = []
    for level in prediction.maps:
        truth, valid = level_truth(pairs.map, pairs.valid, level.shape[-1])
        found = to_pixels(level.float().movedim(1, -1), size, net.config.align_corners)
        levels.append([_array(values) for values in (found, truth, valid)])
    matchability = None
    if prediction.logits:
        matchability = _array(prediction.logits[-1][:, 0].float().sigmoid())
    known = _array(pairs.known)
    return [
        Comparison(
            tuple(LevelMap(found[i], truth[i], valid[i]) for found, truth, valid in levels),
            None if matchability is None else matchability[i],
            known[i],
        )
        for i in range(len(pairs.map))
    ]


def validate(net: DGCNet, batches: Iterable[TrainingPairs]) -> dict[str, float]:
    """Figures over the pairs, in pixels of 240.

    `aepe` (over valid pixels, mean of a pair, then over pairs), `epe_median` (of all valid
    pixels), `pck3` (share of valid pixels within 3 px), `sure3` (the same over pixels that the net
    gives matchability above one half), `jaccard` of the mask (mean over pairs), and each level's
    `aepe15` to `aepe240`. The mask's figures leave out pixels of which nothing is known, and are
    NaN for a net without one.
    """
    per_level: dict[int, list[float]] = {cells: [] for cells in LEVEL_SIZES[::-1]}
    errors, sure_errors, overlaps = [], [], []
    for pairs in batches:
        for pair in compare(net, pairs):
            for level in pair.levels:
                if level.valid.any():
                    per_level[len(level.valid)].append(level.aepe)
            distance = pair.errors
            errors.append(distance[pair.finest.valid])
            if pair.mask is not None:
                overlaps.append(jaccard(pair.mask[pair.known], pair.finest.valid[pair.known]))
                sure_errors.append(distance[pair.mask & pair.known])
    everywhere = np.concatenate(errors) if errors else np.zeros(0)
    figures = {
        "aepe": _mean(per_level[INPUT_SIZE]),
        "epe_median": float(np.median(everywhere)) if len(everywhere) else float("nan"),
        "pck3": _mean(everywhere <= 3),
        "sure3": _mean(np.concatenate(sure_errors) <= 3) if sure_errors else float("nan"),
        "jaccard": _mean(overlaps),
    }
    return figures | {f"aepe{cells}": _mean(values) for cells, values in per_level.items()}


def _array(values: Tensor) -> np.ndarray:
    return values.cpu().numpy()


def _mean(values: list[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
