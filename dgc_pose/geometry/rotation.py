"""Rotations: angles, quaternions, and the rotation that best turns one set of rays into another."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def rotation_angle_deg(R: np.ndarray) -> float:
    """Angle of a rotation matrix (3, 3), degrees, 0 to 180."""
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))


def quaternion_wxyz(R: np.ndarray) -> np.ndarray:
    """The unit quaternion (w, x, y, z) of a rotation matrix (3, 3), with w >= 0."""
    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True)
    return np.array([w, x, y, z])


def fit_rotation(rays1: np.ndarray, rays2: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that minimises sum |ray2 - R ray1|^2 over unit rays (N, 3) (Kabsch)."""
    U, _, Vt = np.linalg.svd(rays2.T @ rays1)
    sign = np.sign(np.linalg.det(U @ Vt))
    return U @ np.diag([1.0, 1.0, sign]) @ Vt
