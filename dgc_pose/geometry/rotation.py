"""Rotation matrices as angles and quaternions, by SciPy."""

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
