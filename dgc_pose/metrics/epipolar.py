"""How far matches lie from the true epipolar lines: D_e of the paper's section 4.4."""

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.epipolar import (
    essential_from_pose,
    fundamental_from_essential,
    symmetric_epipolar_distance,
)


def true_fundamental(camera1: Camera, camera2: Camera, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """F (3, 3) of the pose x2 = R x1 + t, for pixels of the cameras: x2^T F x1 = 0."""
    E = essential_from_pose(R, t / np.linalg.norm(t))
    return fundamental_from_essential(E, camera1.K, camera2.K)


def epipolar_residuals_px(
    points1: np.ndarray, points2: np.ndarray, camera1: Camera, camera2: Camera, E: np.ndarray
) -> np.ndarray:
    """Symmetric epipolar distances (N,) of matches in pixels under E (3, 3), without distortion.

    points1, points2: (N, 2) pixels of the cameras' images, as distorted as those are. NaN if that
    cannot be undone.
    """
    F = fundamental_from_essential(E, camera1.K, camera2.K)
    ideal1, ideal2 = ideal_pixels(points1, camera1), ideal_pixels(points2, camera2)
    return symmetric_epipolar_distance(ideal1, ideal2, F)


def ideal_pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels (..., 2) of a camera, where they would be without the distortion of its lens; NaN if
    that cannot be undone."""
    if camera.distortion is None:
        return points
    normalised = camera.normalise(points.reshape(-1, 2)).reshape(points.shape)
    return normalised @ camera.K[:2, :2].T + camera.K[:2, 2]


def median_and_mean(points1: np.ndarray, points2: np.ndarray, F: np.ndarray) -> tuple[float, float]:
    """Median and mean of the symmetric epipolar distances of matches (..., 2), in pixels.

    A match that is not finite counts as infinitely far, and so do no matches at all.
    """
    first, second = (
        np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in (points1, points2)
    )
    if not len(first):
        return np.inf, np.inf
    finite = np.isfinite(first).all(1) & np.isfinite(second).all(1)
    distances = np.full(len(first), np.inf)
    distances[finite] = symmetric_epipolar_distance(first[finite], second[finite], F)
    return float(np.median(distances)), float(distances.mean())
