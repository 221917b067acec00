"""The essential matrix, distances to it, and the depths and angles of matches under a pose.

x2^T E x1 = 0 for homogeneous points x1, x2.
"""

import numpy as np

_TINY = 1e-300  # makes 0 / 0 at the epipoles 0


def skew(v: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of the cross product with v (3,)."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]], dtype=np.float64)


def homogeneous(points: np.ndarray) -> np.ndarray:
    """Points (N, 2) with a third coordinate of 1: (N, 3)."""
    return np.column_stack([points, np.ones(len(points))])


def essential_from_pose(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """E = [t]x R of the pose x2 = R x1 + t."""
    return skew(t) @ R


def tangent_axes(t: np.ndarray) -> np.ndarray:
    """Two unit vectors perpendicular to t (3,) and to each other, as columns (3, 2)."""
    axes: np.ndarray = np.linalg.svd(t[None])[2][1:].T
    return axes


def fundamental_from_essential(E: np.ndarray, K1: np.ndarray, K2: np.ndarray) -> np.ndarray:
    """F = K2^-T E K1^-1: the essential matrix for pixels instead of normalised points."""
    return np.linalg.inv(K2).T @ E @ np.linalg.inv(K1)


def pose_candidates(E: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The four poses (R, t), |t| = 1, of an essential matrix (3, 3)."""
    import cv2  # slow to import, and cameras do not need it

    R1, R2, t = cv2.decomposeEssentialMat(E)
    t = t[:, 0] / np.linalg.norm(t)
    return [(R1, t), (R2, t), (R1, -t), (R2, -t)]


def epipolar_lines(
    points1: np.ndarray, points2: np.ndarray, F: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x2^T F x1 (N,), and the normals (2, N) of the epipolar lines in images 1 and 2."""
    # Points as columns: NumPy is slow along short axes.
    x1 = points1.T
    x2 = points2.T
    lines2 = F[:, :2] @ x1 + F[:, 2:]
    lines1 = F[:2, :2].T @ x2 + F[2:, :2].T
    return (x2 * lines2[:2]).sum(0) + lines2[2], lines1, lines2[:2]


def epipolar_terms(
    points1: np.ndarray, points2: np.ndarray, F: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x2^T F x1 (N,), and the squared norms (N,) of the normals of the lines in images 1 and 2."""
    algebraic, lines1, lines2 = epipolar_lines(points1, points2, F)
    return algebraic, (lines1**2).sum(0), (lines2**2).sum(0)


def sampson_distance(points1: np.ndarray, points2: np.ndarray, F: np.ndarray) -> np.ndarray:
    """First-order distance (N,) of matches to the epipolar constraint, in the points' unit.

    |x2^T F x1| / sqrt(|l1|^2 + |l2|^2), l1 and l2 the normals of the epipolar lines (Hartley and
    Zisserman, equation 11.9).
    """
    algebraic, squared1, squared2 = epipolar_terms(points1, points2, F)
    return np.abs(algebraic) / np.sqrt(squared1 + squared2 + _TINY)


def symmetric_epipolar_distance(
    points1: np.ndarray, points2: np.ndarray, F: np.ndarray
) -> np.ndarray:
    """Mean (N,) of the distances of x2 to the line F x1 and of x1 to the line F^T x2.

    In the points' unit: pixels with F, focal lengths with E (the D_e of the paper's section 4.4).
    """
    algebraic, squared1, squared2 = epipolar_terms(points1, points2, F)
    inverse = 1 / np.sqrt(squared1 + _TINY) + 1 / np.sqrt(squared2 + _TINY)
    return np.abs(algebraic) * inverse / 2


def unit_rays(points: np.ndarray) -> np.ndarray:
    """Unit rays (N, 3) through normalised image points (N, 2)."""
    rays = homogeneous(points)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def depths(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths (N,) along the optical axes of cameras 1 and 2, in units of |t|, where the two rays of
    normalised points come nearest to each other; infinite for parallel rays."""
    # Points as columns: NumPy is slow along short axes.
    a = R[:, :2] @ points1.T + R[:, 2:]  # rays 1 in the axes of camera 2
    b = homogeneous(points2).T
    # Least squares of d1 * a + t = d2 * b: two unknowns, solved by Cramer's rule.
    aa = (a**2).sum(0)
    bb = (b**2).sum(0)
    ab = (a * b).sum(0)
    at = t @ a
    bt = t @ b
    determinant = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth1 = (ab * bt - bb * at) / determinant
        depth2 = (aa * bt - ab * at) / determinant
    return np.nan_to_num(depth1, nan=np.inf), np.nan_to_num(depth2, nan=np.inf)


def triangulation_angles_deg(points1: np.ndarray, points2: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Angle (N,) between the two rays of each normalised match, degrees, 0 to 180."""
    rays1 = unit_rays(points1) @ R.T
    rays2 = unit_rays(points2)
    sine = np.linalg.norm(np.cross(rays1, rays2), axis=1)
    return np.degrees(np.arctan2(sine, (rays1 * rays2).sum(1)))


def epipolar_angles(points1: np.ndarray, points2: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Angle (N,), radians, between ray 2 of normalised matches and the epipolar plane of ray 1."""
    normals = homogeneous(points1) @ E.T
    lengths = np.linalg.norm(normals, axis=1)
    sine = np.abs((normals * unit_rays(points2)).sum(1)) / np.where(lengths > 0, lengths, 1)
    return np.arcsin(np.clip(sine, 0, 1))
