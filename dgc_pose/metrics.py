"""Errors of a relative pose, and residuals of matches under it."""

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.epipolar import fundamental_from_essential, symmetric_epipolar_distance


def rotation_error_deg(R: np.ndarray, R_gt: np.ndarray) -> float:
    """Angle of the rotation R_gt^T R between two rotation matrices (3, 3), degrees in [0, 180].

    acos((trace - 1) / 2), computed as an arctangent, which is accurate near 0 and 180 too.
    """
    R = np.asarray(R_gt, dtype=np.float64).T @ np.asarray(R, dtype=np.float64)
    axis = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    # The axis has length 2 sin(angle), and trace - 1 is 2 cos(angle).
    return float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1)))


def translation_error_deg(t: np.ndarray, t_gt: np.ndarray) -> float:
    """Angle between two directions (3,) of any length but 0, degrees in [0, 180]."""
    a, b = (np.asarray(direction, dtype=np.float64) for direction in (t, t_gt))
    a = a / np.abs(a).max()
    b = b / np.abs(b).max()
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def epipolar_residuals_px(
    points1: np.ndarray, points2: np.ndarray, camera1: Camera, camera2: Camera, E: np.ndarray
) -> np.ndarray:
    """Symmetric epipolar distances (N,) of matches in pixels under E (3, 3), without distortion.

    points1, points2: (N, 2) pixels of the images, with distortion. NaN where the distortion cannot
    be undone.
    """
    F = fundamental_from_essential(E, camera1.K, camera2.K)
    ideal1 = ideal_pixels(points1, camera1)
    ideal2 = ideal_pixels(points2, camera2)
    return symmetric_epipolar_distance(ideal1, ideal2, F)


def ideal_pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels (..., 2) of a camera without the distortion of its lens; NaN where it cannot be
    undone."""
    if camera.distortion is None:
        return points
    normalised = camera.normalise(points.reshape(-1, 2)).reshape(points.shape)
    return normalised @ camera.K[:2, :2].T + camera.K[:2, 2]
