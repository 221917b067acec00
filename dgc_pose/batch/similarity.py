"""How similar two images are, by the engine's coarsest features: a matrix product a pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ROWS = 64  # images compared with one at a time, which bounds the memory


def similarities(features: Sequence[np.ndarray | None]) -> np.ndarray:
    """Scores (N, N) float32 of all pairs; the diagonal is 0, and pairs of a missing image -1.

    features: for each image its coarsest cells (cells, C), of unit length; None for an image that
    cannot be read. The score of two images is the mean cosine of the cells that are mutual nearest
    neighbours, times their share of all cells: cells that only one image shows have no partner.
    """
    count = len(features)
    scores = np.full((count, count), -1.0, dtype=np.float32)
    np.fill_diagonal(scores, 0)
    known = [i for i, own in enumerate(features) if own is not None]
    for position, i in enumerate(known):
        own = _array(features[i])
        others = known[position + 1 :]
        for start in range(0, len(others), _ROWS):
            part = others[start : start + _ROWS]
            stack = np.stack([_array(features[j]) for j in part])  # (m, cells, C)
            cosines = stack.reshape(-1, stack.shape[-1]) @ own.T
            cosines = cosines.reshape(len(part), -1, len(own))
            scores[i, part] = scores[part, i] = _mutual(cosines)
    return scores


def _mutual(cosines: np.ndarray) -> np.ndarray:
    """Scores (m,) of cosines (m, cells of the other, cells of this one)."""
    best = cosines.argmax(2)  # of this one, for each cell of the other
    back = cosines.argmax(1)
    rows = np.arange(cosines.shape[1])
    mutual = np.take_along_axis(back, best, 1) == rows
    values = np.take_along_axis(cosines, best[..., None], 2)[..., 0].clip(0)
    return (values * mutual).sum(1) / cosines.shape[1]


def _array(features: np.ndarray | None) -> np.ndarray:
    assert features is not None
    return features.astype(np.float32)
