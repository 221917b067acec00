"""The interface that the robust estimators of three libraries share."""

from __future__ import annotations

from typing import Protocol

import numpy as np

# The libraries expect pixels: normalised points are passed as pixels of a camera of this focal
# length.
VIRTUAL_FOCAL = 1000.0
MINIMAL = 5  # matches that determine an essential matrix


class Backend(Protocol):
    """One RANSAC run for the essential matrix."""

    def __call__(
        self,
        points1: np.ndarray,
        points2: np.ndarray,
        *,
        threshold: float,
        iterations: int,
        seed: int,
    ) -> list[np.ndarray]:
        """Essential matrices (3, 3) of one run: usually one, several if they tie, or none.

        points1, points2: normalised (N, 2), N >= 5; threshold: epipolar error in the same unit.
        The same seed gives the same answer to the bit; another seed draws other samples.
        """
        ...
