"""Validation on fixed pairs of photographs that no run trains on."""

from collections.abc import Iterable

import numpy as np
import torch

from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.net import DGCNet
from dgc_pose.training.evaluation.map_comparison import compare
from dgc_pose.training.evaluation.map_scores import WITHIN, score_map, summarise_maps
from dgc_pose.training.synthesis.map_pairs import MapPairs
from dgc_pose.training.synthesis.options import PairOptions
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs

_SEED = 20190108  # of the validation pairs of every run


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

    `aepe` (of valid pixels, mean of a pair, then over pairs), `epe_median` (of all valid pixels),
    `pck3` (share of valid pixels within 3 px), `sure3` (the same over pixels of matchability one
    half or more), `jaccard` of the mask (mean over pairs), and each level's `aepe15` to `aepe240`.
    The mask's figures are over known pixels, and NaN for a network without a mask.
    """
    comparisons = [pair for pairs in batches for pair in compare(net, pairs)]
    summary = summarise_maps([score_map("network", "", "", pair) for pair in comparisons])
    errors = np.concatenate([pair.errors[pair.finest.valid] for pair in comparisons])
    figures = {
        "aepe": summary.aepe,
        "epe_median": float(np.median(errors)) if len(errors) else float("nan"),
        "pck3": summary.within[WITHIN.index(3.0)],
        "sure3": float("nan"),
        "jaccard": summary.jaccard,
    }
    if summary.reliability is not None:
        figures["sure3"] = summary.reliability.share_correct_above(0.5)
    levels = zip(LEVEL_SIZES[::-1], summary.level_aepe, strict=True)
    return figures | {f"aepe{cells}": value for cells, value in levels}
