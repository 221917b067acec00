"""The interface that the robust estimators of three libraries share, and the choice among them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dgc_pose.estimation.options import EstimatorName

# Libraries expect pixels; normalised points are handed to them as pixels of this focal length.
VIRTUAL_FOCAL = 1000.0
MINIMAL = 5  # matches that an essential matrix needs
# Backends whose runs may go side by side: each has a random generator of its own. The others seed
# one of the process or of the thread.
SIDE_BY_SIDE: frozenset[EstimatorName] = frozenset({"poselib"})


class Backend(Protocol):
    """One RANSAC run on the essential matrix."""

    def __call__(
        self,
        points1: np.ndarray,
        points2: np.ndarray,
        *,
        threshold: float,
        iterations: int,
        seed: int,
    ) -> list[np.ndarray]:
        """Essential matrices (3, 3) found in one run: one, several where they tie, or none.

        points1, points2: normalised (N, 2), N >= 5; threshold: epipolar error in the same unit.
        The same seed gives the same answer to the bit; another seed draws other samples.
        """
        ...


def get_backend(name: EstimatorName) -> Backend:
    """The backend of that name; its library is imported here and not before."""
    if name == "poselib":
        from dgc_pose.estimation.poselib_backend import run_poselib

        return run_poselib
    if name == "pycolmap":
        from dgc_pose.estimation.pycolmap_backend import run_pycolmap

        return run_pycolmap
    from dgc_pose.estimation.opencv_backend import run_opencv

    return run_opencv
