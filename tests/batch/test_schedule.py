"""The order of the pairs: how often an image is loaded into a memory that holds few."""

from functools import lru_cache

import numpy as np
import pytest

from dgc_pose.batch.pair_choice import parse_pair_choice
from dgc_pose.batch.schedule import tile_order


@pytest.mark.parametrize(
    ("way", "count", "capacity", "loads"),
    [
        ("sequential:3", 60, 12, 60),
        # In tiles of 5 images, each of 8 tiles is loaded with each other: some 8 * 8 / 2 * 5.
        ("exhaustive", 40, 10, 200),
        ("exhaustive", 9, 1, 81),
        ("exhaustive", 1, 4, 0),
    ],
)
def test_pairs_are_worked_through_in_tiles(way: str, count: int, capacity: int, loads: int) -> None:
    pairs = np.array(parse_pair_choice(way).pairs(count), np.int64).reshape(-1, 2)
    pairs = np.random.default_rng(1).permutation(pairs)
    order = tile_order(pairs, capacity)
    assert sorted(order) == list(range(len(pairs)))
    load = lru_cache(capacity)(lambda image: None)
    for image in pairs[order].ravel().tolist():
        load(image)
    assert load.cache_info().misses <= loads
