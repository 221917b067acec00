"""Every network on every pair with a known map; the worst pairs are kept for pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dgc_pose.evaluation.map_comparison import Comparison, compare
from dgc_pose.evaluation.map_scores import PairScores, score
from dgc_pose.network.net import DGCNet
from dgc_pose.synthesis.map_pairs import MapPairs


@dataclass(frozen=True, eq=False)
class Case:
    """A batch of 240x240 pairs, named."""

    group: str  # that the figures are averaged in
    names: tuple[str, ...]  # of each pair
    pairs: MapPairs


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one network made of one pair."""

    scores: PairScores
    comparison: Comparison
    image1: np.ndarray  # (240, 240, 3) uint8
    image2: np.ndarray  # (240, 240, 3) uint8


def run(
    cases: Iterable[Case], nets: Mapping[str, DGCNet], per_axis: bool = False
) -> Iterator[Outcome]:
    """Yield the outcome of each pair by each network, case by case, as each is done."""
    for case in cases:
        for method, net in nets.items():
            device = next(net.parameters()).device
            comparisons = compare(net, case.pairs.to(device))
            for index, (name, comparison) in enumerate(zip(case.names, comparisons, strict=True)):
                yield Outcome(
                    score(method, case.group, name, comparison, per_axis),
                    comparison,
                    _picture(case.pairs, index, 1),
                    _picture(case.pairs, index, 2),
                )


class WorstPairs:
    """The outcomes of largest AEPE, `count` a method."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._kept: dict[str, list[Outcome]] = {}

    def add(self, outcome: Outcome) -> None:
        if not outcome.scores.valid:
            return  # nothing in it could be found
        kept = self._kept.setdefault(outcome.scores.method, [])
        kept.append(outcome)
        kept.sort(key=lambda own: -np.nan_to_num(own.scores.aepe, nan=np.inf))
        del kept[self._count :]

    def of(self, method: str) -> list[Outcome]:
        """The worst first."""
        return self._kept.get(method, [])


def _picture(pairs: MapPairs, index: int, number: int) -> np.ndarray:
    image = (pairs.image1 if number == 1 else pairs.image2)[index]
    pixels: np.ndarray = (255 * image.permute(1, 2, 0)).round().byte().cpu().numpy()
    return pixels
