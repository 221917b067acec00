"""pycolmap: COLMAP's LO-RANSAC on the five-point solver."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.backend import VIRTUAL_FOCAL
from dgc_pose.system.colmap_library import pycolmap


def run_pycolmap(
    points1: np.ndarray, points2: np.ndarray, *, threshold: float, iterations: int, seed: int
) -> list[np.ndarray]:
    """See `Backend`."""
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=2, height=2, params=[VIRTUAL_FOCAL, 0.0, 0.0]
    )
    options = pycolmap.RANSACOptions()
    options.max_error = threshold * VIRTUAL_FOCAL
    options.min_num_trials = options.max_num_trials = iterations
    options.random_seed = seed
    answer = pycolmap.estimate_essential_matrix(
        points1 * VIRTUAL_FOCAL, points2 * VIRTUAL_FOCAL, camera, camera, options
    )
    return [] if answer is None else [np.asarray(answer["E"])]
