"""The list of a run: drawn from the calibration, or a file's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dgc_pose.benchmarks.dtu.dataset import Dataset
from dgc_pose.benchmarks.dtu.pair_files import read_pair_file
from dgc_pose.benchmarks.dtu.pairs import PairOptions, ScenePair, draw, find_pairs, pair_of
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.errors import InputError

PAIRS = 3000  # of the paper


@dataclass(frozen=True)
class Entry:
    """A pair of the list."""

    scene: int
    view1: int
    view2: int
    overlap: float  # 0 to 1
    pair: Pair


def choose_pairs(
    dataset: Dataset, pairs: str | int, *, seed: int, scenes: Sequence[int] | None = None
) -> list[ScenePair]:
    """The pairs that a number (so many, drawn by the seed) or a path (a list's) stands for, scene
    by scene, so that what is kept of a scene's images serves all its pairs.

    Raises InputError where the number is not positive or no views fit, and what `read_pair_file`
    raises.
    """
    number = _number(pairs)
    if number is None:
        chosen = read_pair_file(pairs, dataset, scenes=scenes)
    else:
        options = PairOptions(pairs=number, seed=seed)
        chosen = draw(find_pairs(dataset, options), options)
        if not chosen:
            raise InputError(
                f"{dataset.root}: no two views turn by {options.min_rotation:g} to "
                f"{options.max_rotation:g} degrees and share {options.min_overlap:g} of their view"
            )
    return sorted(chosen, key=lambda pair: pair.scene)


def make_entries(dataset: Dataset, pairs: Sequence[ScenePair]) -> list[Entry]:
    """The pairs with their images, cameras and true poses."""
    return [
        Entry(one.scene, one.view1, one.view2, one.overlap, pair_of(dataset, one)) for one in pairs
    ]


def _number(pairs: str | int) -> int | None:
    if isinstance(pairs, str) and Path(pairs).exists():
        return None
    try:
        return int(pairs)
    except ValueError:
        return None  # a path that is not there, which reading it will say
