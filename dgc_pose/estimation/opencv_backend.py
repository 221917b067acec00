"""OpenCV: USAC with MAGSAC scores. Plain RANSAC there has no local optimisation."""

from __future__ import annotations

import cv2
import numpy as np

from dgc_pose.estimation.backend import VIRTUAL_FOCAL

_CONFIDENCE = 1.0  # with less, even 1 - 1e-12, a run on good matches ends after a few iterations


def run_opencv(
    points1: np.ndarray, points2: np.ndarray, *, threshold: float, iterations: int, seed: int
) -> list[np.ndarray]:
    """See `Backend`. OpenCV ignores cv2.setRNGSeed and draws the same samples for the same order of
    points: both the order and the generator's state come from the seed."""
    order = np.random.default_rng(seed).permutation(len(points1))
    params = cv2.UsacParams()
    params.confidence = _CONFIDENCE
    params.maxIterations = iterations
    params.threshold = threshold * VIRTUAL_FOCAL
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.randomGeneratorState = seed % (2**31)
    K = np.diag([VIRTUAL_FOCAL, VIRTUAL_FOCAL, 1.0])
    try:
        stack, _ = cv2.findEssentialMat(
            points1[order] * VIRTUAL_FOCAL, points2[order] * VIRTUAL_FOCAL, K, K, None, None, params
        )
    except cv2.error:  # degenerate points
        return []
    if stack is None:
        return []
    # A minimal sample gives a stack of up to ten matrices, one below the other.
    return [E for E in np.asarray(stack).reshape(-1, 3, 3) if np.isfinite(E).all() and E.any()]
