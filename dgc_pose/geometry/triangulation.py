"""Depths and angles of matches under a pose, each ray pair solved in closed form."""

from __future__ import annotations

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

    points1, points2: normalised (N, 2). Each point is where the two rays of the pose
    x2 = R x1 + t come nearest to each other; rays that are parallel meet at infinite depth.
    """
    turned = homogeneous(points1) @ R.T
    seen = homogeneous(points2)
    # Least squares of d1 * turned + t = d2 * seen: two unknowns, solved by Cramer's rule.
    aa, bb = (turned**2).sum(1), (seen**2).sum(1)
    ab = (turned * seen).sum(1)
    at, bt = turned @ t, seen @ t
    determinant = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth1 = (ab * bt - bb * at) / determinant
        depth2 = (aa * bt - ab * at) / determinant
    return np.nan_to_num(depth1, nan=np.inf), np.nan_to_num(depth2, nan=np.inf)


def triangulate(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> np.ndarray:
    """Points (N, 3) in the frame of camera 1, in units of |t|: the middle of the nearest ends."""
    depth1, depth2 = depths(points1, points2, R, t)
    from1 = depth1[:, None] * homogeneous(points1)
    from2 = (depth2[:, None] * homogeneous(points2) - t) @ R
    return (from1 + from2) / 2


def triangulation_angles_deg(points1: np.ndarray, points2: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Angle (N,) between the two rays of each match, degrees, 0 to 180."""
    turned, seen = unit_rays(points1) @ R.T, unit_rays(points2)
    sine = np.linalg.norm(np.cross(turned, seen), axis=1)
    return np.degrees(np.arctan2(sine, (turned * seen).sum(1)))


def epipolar_angles(points1: np.ndarray, points2: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Angle (N,), radians, between ray 2 of each match and the epipolar plane of its ray 1."""
    normals = homogeneous(points1) @ E.T
    lengths = np.linalg.norm(normals, axis=1)
    sine = np.abs((normals * unit_rays(points2)).sum(1)) / np.where(lengths > 0, lengths, 1)
    return np.arcsin(np.clip(sine, 0, 1))
