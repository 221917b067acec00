"""The order of the pairs, and how blocks are dealt."""

import numpy as np

from dgc_pose.batch.pair_choice import PairChoice
from dgc_pose.batch.schedule import loads, tile_order


def _shuffled(pairs: list[tuple[int, int]], count: int) -> np.ndarray:
    """The pairs in any order, of images in any order."""
    rng = np.random.default_rng(1)
    return rng.permutation(count)[rng.permutation(np.array(pairs))]


def test_all_pairs_are_ordered_once() -> None:
    pairs = _shuffled(PairChoice("exhaustive").pairs(9), 9)
    assert sorted(tile_order(pairs, 9, 4)) == list(range(len(pairs)))
    assert len(tile_order(np.zeros((0, 2), np.int64), 0, 4)) == 0


def test_a_sequence_is_encoded_once_although_memory_holds_few() -> None:
    pairs = _shuffled(PairChoice("sequential", 3).pairs(60), 60)
    assert loads(pairs[tile_order(pairs, 60, 12)], 12) == 60
    assert loads(pairs[tile_order(pairs, 60, 5)], 5) == 60
    assert loads(pairs, 12) > 150


def test_exhaustive_pairs_are_worked_through_in_tiles() -> None:
    """In tiles of 5 images, each of 8 tiles is encoded with each other: some 8 * 8 / 2 * 5."""
    pairs = _shuffled(PairChoice("exhaustive").pairs(40), 40)
    assert loads(pairs[tile_order(pairs, 40, 10)], 10) <= 200
    assert loads(np.array(PairChoice("exhaustive").pairs(40)), 10) > 600
