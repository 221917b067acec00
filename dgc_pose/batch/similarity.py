"""How similar two images are, by the engine's coarsest features: a matrix product a pair."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np


def similarities(features: Sequence[np.ndarray]) -> np.ndarray:
    """Scores (N, N) float32 of all pairs, within -1 and 1; the diagonal is 1.

    features: for each image its coarsest cells (cells, C), of unit length. The score of two images
    is the mean, over the cells of both, of the largest cosine with a cell of the other image.
    """
    cells = [feature.astype(np.float32) for feature in features]
    scores = np.eye(len(cells), dtype=np.float32)
    for i, j in combinations(range(len(cells)), 2):
        cosines = cells[i] @ cells[j].T
        total = cosines.max(0).sum() + cosines.max(1).sum()
        scores[i, j] = scores[j, i] = total / sum(cosines.shape)
    return scores
