"""Every network on every pair of a data set with known maps."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.evaluation.map_comparison import Comparison, compare
from dgc_pose.evaluation.map_scores import PairScores, score_map
from dgc_pose.network.device import choose_device
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.synthesis.map_pairs import MapPairs


@dataclass(frozen=True, eq=False)
class MapCase:
    """A batch of 240x240 pairs, named."""

    group: str  # that the figures are averaged in
    names: tuple[str, ...]  # of each pair
    pairs: MapPairs


@dataclass(frozen=True, eq=False)
class MapSet:
    """A data set: pairs with known maps, batch by batch."""

    cases: Iterable[MapCase]
    total: int  # pairs
    facts: Mapping[str, Any]  # what the JSON says of the set


@dataclass(frozen=True, eq=False)
class MapOutcome:
    """One network's result for one pair."""

    scores: PairScores
    comparison: Comparison
    image1: np.ndarray  # (240, 240, 3) uint8
    image2: np.ndarray  # (240, 240, 3) uint8


def load_networks(names: Sequence[str], *, device: str) -> dict[str, DGCNet]:
    """The bare networks of weights, by name or path, frozen and in evaluation mode.

    Raises InputError for no names or one that is given twice, WeightsError if weights cannot be
    loaded.
    """
    if not names:
        raise InputError("no methods named")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"the method {name} is named twice")
    chosen = choose_device(device)
    return {name: load_network(name, chosen) for name in names}


def map_outcomes(
    cases: Iterable[MapCase], nets: Mapping[str, DGCNet], per_axis: bool = False
) -> Iterator[MapOutcome]:
    """Yield the outcome of each pair by each network, case by case, as soon as it is known."""
    for case in cases:
        images1, images2 = (
            (255 * images.permute(0, 2, 3, 1)).round().byte().cpu().numpy()
            for images in (case.pairs.image1, case.pairs.image2)
        )
        for method, net in nets.items():
            device = next(net.parameters()).device
            comparisons = compare(net, case.pairs.to(device))
            for index, (name, comparison) in enumerate(zip(case.names, comparisons, strict=True)):
                scores = score_map(method, case.group, name, comparison, per_axis)
                yield MapOutcome(scores, comparison, images1[index], images2[index])
