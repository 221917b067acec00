"""The covariance of a pose, and the error that it stays below nine times in ten.

The covariance is the sum of two parts: that of the jackknife (`least_squares`) over blocks of
image 2; and, as the blocks are few and one may hold nearly all information, the usual covariance
with a tenth of the matches.

Cameras that are not exact are parameters as the pose is. Their prior is information that no block
holds: the second part has it.
"""

import math

import numpy as np

from dgc_pose.estimation.intrinsics_prior import EXACT, IntrinsicsPrior, error_slopes, of_pose
from dgc_pose.estimation.least_squares import (
    CORRELATED,
    EFFICIENT,
    KEPT,
    REGULAR,
    block_jackknife,
    cauchy_curvature,
    loss_terms,
)
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem, pose_loss_width
from dgc_pose.estimation.robust_fit import MINIMAL

NORMAL_90 = 1.6449  # standard deviations that a normal variable is off nine times in ten


def pose_covariance(
    problem: TwoViewProblem,
    pose: Hypothesis,
    prior: IntrinsicsPrior = EXACT,
    *,
    fitted: bool = True,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Covariances (6, 6), rad^2, of the rotation vector and of the unit translation; and (12, 12)
    of the parameters of an `IntrinsicsPrior`, 0 of exact cameras.

    Of the pose that minimises the Cauchy loss, at the errors' own width, of the Sampson errors of
    the inliers in front of both cameras. In camera 2's axes: the true pose is exp([w]x) R and t + d
    for a (w, d) of this covariance. d is perpendicular to t, so the rank is 5. None if the inliers
    do not determine the pose. prior: of the cameras that normalised the problem. fitted: whether
    these were fitted to the matches together with the pose, or are known that well from elsewhere.
    """
    inliers = problem.subset(pose.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return None
    error, slopes, tangent = error_slopes(inliers, pose.R, pose.t, prior)
    by_cameras = slopes[:, 5:]
    if not fitted:
        slopes = slopes[:, :5]
    width = pose_loss_width(inliers, pose.R, pose.t)
    variance = CORRELATED * (width / EFFICIENT) ** 2  # of a match: the information is in its unit
    information = variance * (prior if fitted else EXACT).information
    # The blocks show all of the errors of key points, which err independently of their neighbours.
    kept = REGULAR if problem.matches.key_points else KEPT
    terms, count = loss_terms(error, slopes, width), slopes.shape[1]
    total = terms[:, : count**2].sum(0).reshape(count, count)
    try:
        covariance = block_jackknife(total + information, terms, inliers.points2, kept)
        beside = information if problem.matches.key_points else information + total
        inverse = np.linalg.inv(total + information)
        covariance += variance * inverse @ beside @ inverse
        if len(prior) and not fitted:  # the pose moves with the cameras
            weighted = slopes * cauchy_curvature(error, width)[:, None]
            moved = np.linalg.solve(total, weighted.T @ by_cameras)
            covariance += moved @ moved.T
    except np.linalg.LinAlgError:
        return None
    by_pose = of_pose(covariance[:5, :5], tangent)
    of_cameras = covariance[5:, 5:] if fitted else np.eye(len(prior))
    cameras = prior.basis @ of_cameras @ prior.basis.T
    return (by_pose, cameras) if np.isfinite(by_pose).all() and np.isfinite(cameras).all() else None


def error_radius_deg(covariance: np.ndarray) -> float:
    """`error_radius` of a vector of angles, covariance (3, 3) in rad^2. Degrees, at most 180."""
    return min(math.degrees(error_radius(covariance)), 180.0)


def error_radius(covariance: np.ndarray) -> float:
    """The length that a Gaussian vector of covariance (3, 3) stays below nine times in ten.

    The squared length is taken for a scaled chi-square of the same mean and variance (Satterthwaite
    1946), which is exact for a single axis and for equal ones.
    """
    eigenvalues = np.linalg.eigvalsh(covariance).clip(min=0)
    mean, squares = eigenvalues.sum(), (eigenvalues**2).sum()
    if mean == 0:
        return 0.0
    return math.sqrt(float(squares / mean * _chi_square_90(mean**2 / squares)))


def _chi_square_90(freedom: float) -> float:
    """The value that a chi-square variable of 1 to 3 degrees stays below nine times in ten, by
    Newton's method. The import of SciPy takes longer than a pose."""
    x = 0.9 * freedom + 0.45  # half of it, to 3 %, so that four steps find every digit
    for _ in range(4):
        # The regularised lower incomplete gamma function, by its series (DLMF 8.7.1).
        a = freedom / 2
        term = total = math.exp(a * math.log(x) - x - math.lgamma(a + 1))
        density = term * a / x
        while term > 1e-17 * total:
            a += 1
            term *= x / a
            total += term
        x -= (total - 0.9) / density
    return 2 * x
