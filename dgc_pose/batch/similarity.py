"""How similar two images are, by the engine's coarsest features: a matrix product a pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MISSING = -2.0  # score of a pair with an image that cannot be read; all others are within -1 and 1


def similarities(features: Sequence[np.ndarray | None]) -> np.ndarray:
    """Scores (N, N) float32 of all pairs; the diagonal is 1.

    features: for each image its coarsest cells (cells, C), of unit length; None for an image that
    cannot be read. The score of two images is the mean, over the cells of both, of the largest
    cosine with a cell of the other image.
    """
    count = len(features)
    scores = np.full((count, count), MISSING, dtype=np.float32)
    np.fill_diagonal(scores, 1)
    known = [(i, own.astype(np.float32)) for i, own in enumerate(features) if own is not None]
    for position, (i, own) in enumerate(known):
        for j, other in known[position + 1 :]:
            cosines = own @ other.T
            total = cosines.max(0).sum() + cosines.max(1).sum()
            scores[i, j] = scores[j, i] = total / sum(cosines.shape)
    return scores
