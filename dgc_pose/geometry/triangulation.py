"""Depths, triangulation angles and epipolar angles of matches under a pose, in closed form."""

import numpy as np

from dgc_pose.geometry.epipolar import homogeneous


def unit_rays(points: np.ndarray) -> np.ndarray:
    """Unit rays (N, 3) through normalised image points (N, 2)."""
    rays = homogeneous(points)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def depths(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths (N,) along the optical axes of cameras 1 and 2, in units of |t|.

    points1, points2: normalised (N, 2); pose: x2 = R x1 + t. The depths are those of the points at
    which the two rays come nearest to each other; infinite for parallel rays.
    """
    # Points as columns: NumPy is slow along short axes.
    a = R[:, :2] @ points1.T + R[:, 2:]  # rays 1 in the axes of camera 2
    b = homogeneous(points2).T
    # Least squares of d1 * a + t = d2 * b: two unknowns, solved by Cramer's rule.
    aa, bb = (a**2).sum(0), (b**2).sum(0)
    ab = (a * b).sum(0)
    at, bt = t @ a, t @ b
    determinant = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth1 = (ab * bt - bb * at) / determinant
        depth2 = (aa * bt - ab * at) / determinant
    return np.nan_to_num(depth1, nan=np.inf), np.nan_to_num(depth2, nan=np.inf)


def triangulation_angles_deg(points1: np.ndarray, points2: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Angle (N,) between the two rays of each normalised match, degrees, 0 to 180."""
    rays1, rays2 = unit_rays(points1) @ R.T, unit_rays(points2)
    sine = np.linalg.norm(np.cross(rays1, rays2), axis=1)
    return np.degrees(np.arctan2(sine, (rays1 * rays2).sum(1)))


def epipolar_angles(points1: np.ndarray, points2: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Angle (N,), radians, between ray 2 of normalised matches and the epipolar plane of ray 1."""
    normals = homogeneous(points1) @ E.T
    lengths = np.linalg.norm(normals, axis=1)
    sine = np.abs((normals * unit_rays(points2)).sum(1)) / np.where(lengths > 0, lengths, 1)
    return np.arcsin(np.clip(sine, 0, 1))
