"""Shared key points by merging: the best match of each cell of an image becomes a key point.

The matches of each pair are then re-assigned to the nearest key points. This needs no images, and
moves each match by up to the side of a cell, as hloc does with dense matchers.
"""

from collections.abc import Sequence

import numpy as np

from dgc_pose.colmap.options import SharingOptions
from dgc_pose.colmap.shared import PairGeometry, SharedMatches, one_to_one, pairs_by_image
from dgc_pose.geometry.neighbours import nearest_to

_KEY_POINTS_PER_IMAGE = 8192  # unless the options have another number


def merge_by_cells(pairs: Sequence[PairGeometry], options: SharingOptions) -> SharedMatches:
    """Key points in cells, and the matches of each pair re-assigned to them.

    A cell that more pairs have a match in is preferred to one of fewer, then the better score.
    """
    key_points = {
        name: _best_of_cells(name, its_pairs, options)
        for name, its_pairs in pairs_by_image(pairs).items()
    }
    matches = {}
    for pair in pairs:
        distance1, nearest1 = nearest_to(pair.points1, key_points[pair.row.name1])
        distance2, nearest2 = nearest_to(pair.points2, key_points[pair.row.name2])
        near = np.maximum(distance1, distance2) <= options.cell
        if near.any():
            index = np.column_stack([nearest1, nearest2])[near].astype(np.uint32)
            matches[pair.names] = one_to_one(index, pair.scores[near])
    return SharedMatches(key_points, matches)


def _best_of_cells(name: str, pairs: Sequence[PairGeometry], options: SharingOptions) -> np.ndarray:
    """The key points (N, 2) of an image."""
    points = np.concatenate([p.towards(name)[2] for p in pairs])
    scores = np.concatenate([p.scores for p in pairs])
    pair = np.repeat(np.arange(len(pairs)), [len(p.scores) for p in pairs])
    cells = np.floor((points + 0.5) / options.cell).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.ravel()
    pairs_of_cells = np.unique(np.column_stack([cell, pair]), axis=0)
    support = np.bincount(pairs_of_cells[:, 0])[cell]
    order = np.lexsort((-scores, -support))
    _, first = np.unique(cell[order], return_index=True)
    best = order[np.sort(first)][: options.per_image or _KEY_POINTS_PER_IMAGE]
    return points[best]
