"""The order of the pairs in which each image is loaded as few times as memory allows.

Images that are paired get neighbouring ranks (reverse Cuthill-McKee). Of several orders that with
the fewest loads is taken: by rank, which suits sequences, or by tiles of ranks, which suit
images of which most are paired.
"""

from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")
BLOCK = 16  # pairs handed to a worker at a time, and stored together
_TILES = (0.25, 0.5, 0.75)  # sides that are tried, of the images that fit into memory


def tile_order(pairs: np.ndarray, count: int, capacity: int) -> np.ndarray:
    """Indices (P,) of the pairs (P, 2), of `count` images, in the order to work in.

    capacity: images whose features fit into the memory of one worker.
    """
    if len(pairs) == 0:
        return np.zeros(0, dtype=np.int64)
    rank = np.empty(count, dtype=np.int64)
    rank[_reverse_cuthill_mckee(pairs, count)] = np.arange(count)
    low, high = np.sort(rank[pairs], axis=1).T
    orders = [np.lexsort((high, low))]
    for share in _TILES:
        side = max(1, int(share * capacity))
        tile1, tile2 = low // side, high // side
        # Back and forth along the rows of tiles: a row begins with the tile that the last ended at.
        column = np.where(tile1 % 2 == 0, tile2, -tile2)
        orders.append(np.lexsort((low, high, column, tile1)))
    return min(orders, key=lambda order: loads(pairs[order], capacity))


def loads(pairs: np.ndarray, capacity: int) -> int:
    """How often an image is loaded for pairs (P, 2) in this order, if the memory holds `capacity`
    images and drops the least recently used."""
    load = lru_cache(capacity)(lambda image: None)
    for image in pairs.ravel().tolist():
        load(image)
    return load.cache_info().misses


def _reverse_cuthill_mckee(pairs: np.ndarray, count: int) -> list[int]:
    """The images in an order in which those that are paired are near each other.

    Breadth first from an image of few partners, those of fewest partners first. Without SciPy,
    which a batch does not need.
    """
    partners: list[set[int]] = [set() for _ in range(count)]
    for first, second in pairs.tolist():
        partners[first].add(second)
        partners[second].add(first)
    by_degree = sorted(range(count), key=lambda image: len(partners[image]))
    order: list[int] = []
    reached = [False] * count
    for start in by_degree:
        waiting = deque(() if reached[start] else (start,))
        reached[start] = True
        while waiting:
            image = waiting.popleft()
            order.append(image)
            for other in sorted(partners[image], key=lambda i: (len(partners[i]), i)):
                if not reached[other]:
                    reached[other] = True
                    waiting.append(other)
    return order[::-1]


def block_size(pairs: int, workers: int) -> int:
    """Pairs of a block: fewer in a small batch, so that all workers have something to do."""
    return min(BLOCK, max(1, pairs // (4 * workers)))


def blocks_of(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """Runs of at most `size` successive items."""
    return [items[i : i + size] for i in range(0, len(items), size)]
