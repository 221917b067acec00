"""The order of the pairs in which each image is loaded few times."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")
BLOCK = 16  # pairs handed to a worker at a time, and stored together


def tile_order(pairs: np.ndarray, capacity: int) -> np.ndarray:
    """Indices (P,) of the pairs (P, 2) of images in the order to work in: by tiles, of which the
    images fit into memory together.

    capacity: images whose features fit into the memory of one worker.
    """
    low, high = np.sort(pairs, axis=1).T
    side = max(1, capacity // 2)
    tile1, tile2 = low // side, high // side
    # Back and forth along the rows of tiles: a row begins with the tile that the last ended at.
    column = np.where(tile1 % 2 == 0, tile2, -tile2)
    return np.lexsort((low, high, column, tile1))


def block_size(pairs: int, workers: int) -> int:
    """Pairs of a block: fewer in a small batch, so that all workers have something to do."""
    return min(BLOCK, max(1, pairs // (4 * workers)))


def blocks_of(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """Runs of at most `size` successive items."""
    return [items[i : i + size] for i in range(0, len(items), size)]
