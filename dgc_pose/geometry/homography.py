"""Homographies and similarities, by OpenCV: robust fits, transfer error, the poses of a plane."""

import cv2
import numpy as np

from dgc_pose.geometry.epipolar import homogeneous

# OpenCV's MAGSAC expects pixels: it drops most inliers of normalised points.
_PIXELS = 1000.0


def fit_homography(
    points1: np.ndarray, points2: np.ndarray, threshold: float, seed: int = 0
) -> np.ndarray | None:
    """H (3, 3) with x2 ~ H x1 by MAGSAC and least squares on its inliers; None if this fails.

    points1, points2: normalised (N, 2); threshold: on the transfer error, in the same unit.
    """
    if len(points1) < 4:
        return None
    params = cv2.UsacParams()
    params.threshold = threshold * _PIXELS
    params.maxIterations = 2000
    params.confidence = 0.9999
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.randomGeneratorState = seed % 2**31  # a C int
    try:
        H, _ = cv2.findHomography(points1 * _PIXELS, points2 * _PIXELS, params)
        if H is None or not np.isfinite(H).all():
            return None
        H = H * np.outer([1 / _PIXELS, 1 / _PIXELS, 1], [_PIXELS, _PIXELS, 1])
        inliers = transfer_error(points1, points2, H) < threshold
        fitted, _ = cv2.findHomography(points1[inliers], points2[inliers], 0)
    except cv2.error:  # degenerate points, such as copies of one
        return None
    return H if fitted is None else fitted


def fit_similarity(points1: np.ndarray, points2: np.ndarray, threshold: float) -> np.ndarray | None:
    """H (3, 3) with x2 = H x1, a scale, a rotation in the image and a shift, by RANSAC; None if
    this fails. Points and threshold as for `fit_homography`."""
    if len(points1) < 2:
        return None
    affine, _ = cv2.estimateAffinePartial2D(
        points1 * _PIXELS, points2 * _PIXELS, ransacReprojThreshold=threshold * _PIXELS
    )
    if affine is None:
        return None
    return np.vstack([affine * (1, 1, 1 / _PIXELS), (0, 0, 1)])


def transfer_error(points1: np.ndarray, points2: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Distance (N,) in image 2 from H x1 to x2, in its unit; infinite beyond the horizon."""
    moved = homogeneous(points1) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(moved[:, :2] / moved[:, 2:] - points2, axis=1)
    return np.nan_to_num(distance, nan=np.inf)


def homography_poses(H: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The poses (R, t), |t| = 1, of two views of a plane with x2 ~ H x1 in normalised points, with
    both signs of each translation; none if the homography is a rotation."""
    _, rotations, translations, _ = cv2.decomposeHomographyMat(H, np.eye(3))
    poses = []
    for R, t in zip(rotations, translations, strict=True):
        length = np.linalg.norm(t)
        if length > 1e-9:
            poses += [(R, t[:, 0] / length), (R, -t[:, 0] / length)]
    return poses
