"""The covariance of a pose, and the error that it stays below nine times in ten.

Errors of dense matches are correlated: neighbours lie on the same misplaced surface, so a thousand
of them carry little more information than a few. The usual covariance takes all matches for
independent and is several times too small. Here image 2 is divided into blocks, and the pose's
spread is measured by leaving out one block after the other (the delete-a-group jackknife, Kott
2001), so that correlated errors are left out together.
"""

import math

import numpy as np

from dgc_pose.estimation.model import Model, error_scale
from dgc_pose.estimation.poselib_calls import MINIMAL
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import epipolar_terms, essential_from_pose, homogeneous, skew

BLOCKS = 3  # along the longer side of the inliers in image 2; see docs/experiments.md
_SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of the blocks, in blocks
_RIDGE = 1e-9  # keeps the remaining information regular if one block has nearly all


def pose_covariance(problem: TwoViewProblem, model: Model) -> np.ndarray | None:
    """Covariance (6, 6), rad^2, of the rotation vector and of the unit translation.

    Of the pose that minimises the Cauchy loss, at the errors' own scale, of the Sampson errors of
    the inliers in front of both cameras. In camera 2's axes: the true pose is exp([w]x) R and t + d
    for a (w, d) of this covariance. d is perpendicular to t, so the rank is 5. None if the inliers
    do not determine the pose.
    """
    inliers = problem.subset(model.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return None
    error, slopes, tangent = error_slopes(inliers, model.R, model.t)
    squared = (error / error_scale(inliers, model.R, model.t)) ** 2
    # Negative for errors beyond the loss's inflection; a match must not count as negative evidence.
    curvature = np.maximum(1 - squared, 0) / (1 + squared) ** 2
    gradients = slopes * (error / (1 + squared))[:, None]
    information = (slopes * curvature[:, None])[:, :, None] * slopes[:, None]
    terms = np.column_stack([information.reshape(-1, 25), gradients])  # (N, 30)
    total = information.sum(0)
    covariances = []
    for shift in _SHIFTS:
        sums = _membership(inliers.points2, shift).T @ terms
        count = len(sums)
        left_out, gradient = sums[:, :25].reshape(-1, 5, 5), sums[:, 25:, None]
        try:
            moves = np.linalg.solve((1 + _RIDGE) * total - left_out, gradient)[:, :, 0]
        except np.linalg.LinAlgError:
            return None
        covariances.append((count - 1) / count * moves.T @ moves)
    expand = np.zeros((6, 5))
    expand[:3, :3], expand[3:, 3:] = np.eye(3), tangent
    covariance = expand @ np.mean(covariances, axis=0) @ expand.T
    return covariance if np.isfinite(covariance).all() else None


def error_radii_deg(covariance: np.ndarray | None) -> tuple[float | None, float | None]:
    """`error_radius_deg` of the rotation and of the translation of a pose's covariance (6, 6)."""
    if covariance is None:
        return None, None
    return error_radius_deg(covariance[:3, :3]), error_radius_deg(covariance[3:, 3:])


def error_radius_deg(covariance: np.ndarray) -> float:
    """The length that a Gaussian vector of angles, covariance (3, 3) in rad^2, stays below nine
    times in ten. Degrees, at most 180.

    The squared length is taken for a scaled chi-square of the same mean and variance (Satterthwaite
    1946), which is exact for a single axis and for equal ones.
    """
    eigenvalues = np.linalg.eigvalsh(covariance).clip(min=0)
    mean, squares = eigenvalues.sum(), (eigenvalues**2).sum()
    if mean == 0:
        return 0.0
    quantile = squares / mean * _chi_square_90(mean**2 / squares)
    return min(math.degrees(math.sqrt(quantile)), 180.0)


def _chi_square_90(freedom: float) -> float:
    """The value that a chi-square variable stays below nine times in ten, by Newton's method.

    freedom: degrees, above 0, at most some hundred. The import of SciPy takes longer than a pose.
    """
    half = value = freedom / 2
    for _ in range(100):  # about six are needed
        slope = math.exp((half - 1) * math.log(value) - value - math.lgamma(half))
        # Left of the mode a step may lead below 0.
        following = max(value - (_incomplete_gamma(half, value) - 0.9) / slope, value / 8)
        if abs(following - value) <= 1e-14 * value:
            break
        value = following
    return 2 * following


def _incomplete_gamma(a: float, x: float) -> float:
    """The regularised lower incomplete gamma function P(a, x), by its series (DLMF 8.7.1)."""
    term = total = math.exp(a * math.log(x) - x - math.lgamma(a + 1))
    while term > 1e-17 * total:
        a += 1
        term *= x / a
        total += term
    return total


def error_slopes(
    problem: TwoViewProblem, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed Sampson errors (N,), their derivatives by the pose (N, 5), and a basis (3, 2).

    The parameters are a rotation vector w, R becoming exp([w]x) R, and two coordinates of t along
    the columns of the basis, which are perpendicular to t.
    """
    tangent = np.linalg.svd(t[None])[2][1:].T
    E = essential_from_pose(R, t)
    algebraic, squared1, squared2 = epipolar_terms(problem.points1, problem.points2, E)
    squared = np.maximum(squared1 + squared2, np.finfo(float).tiny)  # 0 at the epipoles
    x1, x2 = homogeneous(problem.points1), homogeneous(problem.points2)
    lines2, lines1 = x1 @ E.T, x2 @ E
    by_rotation = [skew(t) @ skew(axis) @ R for axis in np.eye(3)]
    by_translation = [essential_from_pose(R, axis) for axis in tangent.T]
    slopes = np.empty((len(x1), 5))
    for column, change in enumerate(by_rotation + by_translation):
        changed2, changed1 = x1 @ change.T, x2 @ change
        lengthening = (lines1 * changed1)[:, :2].sum(1) + (lines2 * changed2)[:, :2].sum(1)
        slopes[:, column] = (x2 * changed2).sum(1) - algebraic / squared * lengthening
    root = np.sqrt(squared)
    return algebraic / root, slopes / root[:, None], tangent


def _membership(points: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Membership (N, B), 0 or 1, of points (N, 2) in square blocks, empty blocks left out."""
    low, high = points.min(0), points.max(0)
    # Slightly more than the span, or the farthest point would be alone in a block.
    side = max((1 + 1e-9) * float((high - low).max()), np.finfo(float).tiny) / BLOCKS
    column, row = np.floor((points - low) / side + shift).astype(int).T
    block = column + (BLOCKS + 1) * row
    return (block[:, None] == np.unique(block)).astype(float)
