"""Validation on fixed pairs of photographs that train nothing."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from dgc_pose.evaluation.map_comparison import compare
from dgc_pose.metrics import jaccard
from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.net import DGCNet
from dgc_pose.synthesis.map_pairs import MapPairs
from dgc_pose.synthesis.photos import Photos
from dgc_pose.synthesis.random_pairs import PairOptions, make_pairs

_SEED = 20190108  # of the validation pairs, whatever a run's own seed


def validation_pairs(
    photos: Photos, pairs: int, batch: int, options: PairOptions
) -> list[MapPairs]:
    """The same pairs for every run: batches of 240x240 from the held-back photographs."""
    generator = torch.Generator().manual_seed(_SEED)
    return [
        make_pairs(photos, batch, INPUT_SIZE, generator, options)
        for _ in range(max(1, pairs // batch))
    ]


def validate(net: DGCNet, batches: Iterable[MapPairs]) -> dict[str, float]:
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


def _mean(values: list[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
