"""How far a pose may be off: its covariance, and the error that it stays below nine times in ten.

Dense matches err together: neighbours lie on the same misjudged surface, so a thousand of them say
no more than a few do, and the usual covariance, which takes every match for a witness of its own,
is several times too small. Here image 2 is cut into blocks, and the pose's spread is measured by
leaving out one block after the other (the delete-a-group jackknife, Kott 2001): what errs together
is left out together.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from dgc_pose.geometry.epipolar import epipolar_terms, essential_from_pose, homogeneous, skew

BLOCKS = 3  # along the longer side of the inliers in image 2; see docs/accuracy.md
_SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of the blocks, in blocks
_RIDGE = 1e-9  # keeps what is left of the information regular where one block has nearly all


def pose_covariance(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray, scale: float
) -> np.ndarray | None:
    """Covariance (6, 6), rad^2, of the rotation vector and of the unit translation.

    Of the pose that minimises the Cauchy loss, flattening at `scale`, of the Sampson errors of
    normalised inliers (N, 2). In camera 2's axes: the true pose is exp([w]x) R and t + d for a
    (w, d) of this covariance. d is perpendicular to t, so the rank is 5. None where the matches do
    not determine the pose.
    """
    error, slopes, tangent = error_slopes(points1, points2, R, t)
    squared = (error / scale) ** 2
    # Negative where the loss bends over; no match is to count as knowing less than nothing.
    curvature = np.maximum(1 - squared, 0) / (1 + squared) ** 2
    gradients = slopes * (error / (1 + squared))[:, None]
    information = (slopes * curvature[:, None])[:, :, None] * slopes[:, None]
    terms = np.column_stack([information.reshape(-1, 25), gradients])  # (N, 30)
    total = information.sum(0)
    covariances = []
    for shift in _SHIFTS:
        sums = _membership(points2, shift).T @ terms
        count = len(sums)
        own, pull = sums[:, :25].reshape(-1, 5, 5), sums[:, 25:, None]
        try:
            moves = np.linalg.solve((1 + _RIDGE) * total - own, pull)[:, :, 0]
        except np.linalg.LinAlgError:
            return None
        covariances.append((count - 1) / count * moves.T @ moves)
    expand = np.zeros((6, 5))
    expand[:3, :3], expand[3:, 3:] = np.eye(3), tangent
    covariance = expand @ np.mean(covariances, axis=0) @ expand.T
    return covariance if np.isfinite(covariance).all() else None


def error_radius_deg(covariance: np.ndarray, share: float = 0.9) -> float:
    """The angle that a Gaussian vector of angles, covariance (3, 3) in rad^2, stays below.

    `share` of the time; degrees, at most 180. The squared length is taken for a scaled chi-square
    of the same mean and variance (Satterthwaite 1946), which is exact for a single axis and for
    equal ones.
    """
    eigenvalues = np.linalg.eigvalsh(covariance).clip(min=0)
    mean, squares = eigenvalues.sum(), (eigenvalues**2).sum()
    if mean == 0:
        return 0.0
    # The chi-square's quantile; scipy.stats, which has it too, takes half a second to import.
    quantile = squares / mean * 2 * float(gammaincinv(mean**2 / squares / 2, share))
    return min(float(np.degrees(np.sqrt(quantile))), 180.0)


def error_slopes(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed Sampson errors (N,) of normalised points, and how they change with the pose (N, 5).

    The parameters are a rotation vector w, R becoming exp([w]x) R, and two coordinates of t along
    the columns of the third array (3, 2), which are perpendicular to t.
    """
    tangent = np.linalg.svd(t[None])[2][1:].T
    E = essential_from_pose(R, t)
    algebraic, squared1, squared2 = epipolar_terms(points1, points2, E)
    squared = np.maximum(squared1 + squared2, np.finfo(float).tiny)  # 0 at the epipoles
    x1, x2 = homogeneous(points1), homogeneous(points2)
    lines2, lines1 = x1 @ E.T, x2 @ E
    turned = [skew(t) @ skew(axis) @ R for axis in np.eye(3)]
    moved = [essential_from_pose(R, axis) for axis in tangent.T]
    slopes = np.empty((len(x1), 5))
    for column, change in enumerate(turned + moved):
        changed2, changed1 = x1 @ change.T, x2 @ change
        lengthening = (lines1 * changed1)[:, :2].sum(1) + (lines2 * changed2)[:, :2].sum(1)
        slopes[:, column] = (x2 * changed2).sum(1) - algebraic / squared * lengthening
    root = np.sqrt(squared)
    return algebraic / root, slopes / root[:, None], tangent


def _membership(points: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Which of the square blocks each point (N, 2) lies in: (N, B) of 0 and 1, no block empty."""
    low, high = points.min(0), points.max(0)
    # A little more than the span holds, lest the farthest point get a block of its own.
    side = max((1 + 1e-9) * float((high - low).max()), np.finfo(float).tiny) / BLOCKS
    column, row = np.floor((points - low) / side + shift).astype(int).T
    block = column + (BLOCKS + 1) * row
    return (block[:, None] == np.unique(block)).astype(float)
