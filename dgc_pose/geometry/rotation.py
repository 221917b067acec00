"""Rotation matrices as angles and quaternions, and the rotation between two sets of rays.

In NumPy: the import of SciPy's rotations takes longer than the pose of a pair.
"""

import math

import numpy as np

_ROUNDING = 1e-3  # largest entry of R^T R - 1 that rounding in a file may leave


def is_rotation(R: np.ndarray) -> bool:
    """Whether a matrix (3, 3), of any numbers, is a rotation, up to rounding in a file."""
    if not np.abs(R).max() < 2:  # the product could overflow
        return False
    return bool(np.abs(R.T @ R - np.eye(3)).max() < _ROUNDING and np.linalg.det(R) > 0)


def rotation_angle_deg(R: np.ndarray) -> float:
    """Angle of a rotation matrix (3, 3), degrees, 0 to 180."""
    w, *axis = quaternion_wxyz(R)
    return math.degrees(2 * math.atan2(math.hypot(*axis), w))


def quaternion_wxyz(R: np.ndarray) -> np.ndarray:
    """The unit quaternion (w, x, y, z) of a rotation matrix (3, 3), with w >= 0.

    The eigenvector of the largest eigenvalue of a symmetric matrix: accurate at every angle, and
    for the rotation nearest to R if R is not quite one (Bar-Itzhack 2000).
    """
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    form = np.empty((4, 4))
    form[0, 0] = np.trace(R)
    form[0, 1:] = skew
    form[1:, 0] = skew
    form[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    quaternion: np.ndarray = np.linalg.eigh(form)[1][:, -1]
    # For a half turn both signs are right: the first part that is not 0 becomes positive.
    first = quaternion[np.flatnonzero(np.abs(quaternion) > 1e-15)[0]]
    return quaternion if first > 0 else -quaternion


def rotation_of_quaternion(wxyz: np.ndarray) -> np.ndarray:
    """The rotation matrix (3, 3) of a quaternion (w, x, y, z) of any length. Raises ValueError if
    the length is 0 or not finite."""
    length = float(np.linalg.norm(wxyz))
    if not 0 < length < math.inf:
        raise ValueError("the quaternion is zero")
    w, x, y, z = wxyz / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * (w * cross + cross @ cross)


def aligning_rotation(rays1: np.ndarray, rays2: np.ndarray) -> np.ndarray:
    """The rotation R (3, 3) that minimises the sum of |R rays1 - rays2|^2 over rays (N, 3) (Kabsch
    1976)."""
    u, _, vt = np.linalg.svd(rays2.T @ rays1)
    u[:, 2] *= np.linalg.det(u) * np.linalg.det(vt)  # a rotation, not a reflection
    return u @ vt


def camera_centres(poses: np.ndarray) -> np.ndarray:
    """Positions (N, 3), world, of cameras with cam_from_world poses (N, 3, 4)."""
    return -np.einsum("nji,nj->ni", poses[:, :, :3], poses[:, :, 3])
