"""RANSAC for the essential matrix by OpenCV and by pycolmap, independent of the package."""

import cv2
import numpy as np
import pycolmap

_FOCAL = 1000.0  # the libraries expect pixels


def opencv_essential(points1: np.ndarray, points2: np.ndarray, threshold: float) -> np.ndarray:
    """E (3, 3) of normalised matches (N, 2) by USAC with MAGSAC scores; threshold in their unit."""
    params = cv2.UsacParams()
    params.confidence, params.maxIterations = 1.0, 1000
    params.threshold = threshold * _FOCAL
    params.score, params.loMethod = cv2.SCORE_METHOD_MAGSAC, cv2.LOCAL_OPTIM_SIGMA
    K = np.diag([_FOCAL, _FOCAL, 1])
    E, _ = cv2.findEssentialMat(points1 * _FOCAL, points2 * _FOCAL, K, K, None, None, params)
    return E


def pycolmap_essential(points1: np.ndarray, points2: np.ndarray, threshold: float) -> np.ndarray:
    """As `opencv_essential`, by COLMAP's LO-RANSAC."""
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=2, height=2, params=[_FOCAL, 0, 0])
    ransac = pycolmap.RANSACOptions(max_error=threshold * _FOCAL, random_seed=0)
    pixels = points1 * _FOCAL, points2 * _FOCAL
    return pycolmap.estimate_essential_matrix(*pixels, camera, camera, ransac)["E"]


ORACLES = {"opencv": opencv_essential, "pycolmap": pycolmap_essential}
