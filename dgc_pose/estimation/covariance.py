"""The covariance of a pose, and the bound of its error in nine cases of ten.

The covariance is the sum of two parts: the jackknife (`least_squares`) over blocks of image 2, and
the usual covariance with a tenth of the matches. The jackknife needs the second part because it has
few blocks, and one block may contain nearly all information.

Cameras that are not exact add their parameters to those of the pose. No block contains their prior;
the second part does.
"""

import math

import numpy as np

from dgc_pose.estimation.intrinsics_prior import EXACT, IntrinsicsPrior, error_slopes, expanded
from dgc_pose.estimation.least_squares import (
    KEPT,
    REGULAR,
    block_jackknife,
    cauchy_curvature,
    loss_terms,
    match_variance,
)
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem, pose_loss_width
from dgc_pose.estimation.robust_fit import MINIMAL

NORMAL_90 = 1.6449  # bound of a normal variable in nine cases of ten, standard deviations


def pose_covariance(
    problem: TwoViewProblem,
    pose: Hypothesis,
    prior: IntrinsicsPrior = EXACT,
    *,
    fitted: bool = True,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Covariances (6, 6), rad^2, of the rotation vector and the unit translation; and (12, 12) of
    the parameters of an `IntrinsicsPrior`, 0 for exact cameras. None if the inliers do not
    determine the pose.

    The pose minimises the Cauchy loss, at the errors' own width, of the Sampson errors of the
    inliers in front of both cameras. In camera 2's axes, the true pose is exp([w]x) R and t + d for
    a (w, d) of this covariance; d is perpendicular to t, so the rank is 5. prior: of the cameras
    that normalised the problem. fitted: whether the cameras were fitted together with the pose;
    otherwise the prior is their final uncertainty.
    """
    inliers = problem.subset(pose.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return None
    error, slopes, tangent = error_slopes(inliers, pose.R, pose.t, prior)
    by_cameras = slopes[:, 5:]
    if not fitted:
        slopes = slopes[:, :5]
    width = pose_loss_width(inliers, pose.R, pose.t)
    variance = match_variance(width)  # the unit of the information
    information = variance * (prior if fitted else EXACT).information
    # Errors of key points are independent of their neighbours: the blocks show all of them.
    kept = REGULAR if problem.matches.key_points else KEPT
    terms = loss_terms(error, slopes, width)
    count = slopes.shape[1]
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
    by_pose = expanded(covariance[:5, :5], tangent)
    cameras = prior.covariance(covariance[5:, 5:] if fitted else np.eye(len(prior)))
    return (by_pose, cameras) if np.isfinite(by_pose).all() and np.isfinite(cameras).all() else None


def error_radius_deg(covariance: np.ndarray) -> float:
    """`error_radius` of a vector of angles, covariance (3, 3) in rad^2. Degrees, at most 180."""
    return min(math.degrees(error_radius(covariance)), 180.0)


def error_radius(covariance: np.ndarray) -> float:
    """The bound, in nine cases of ten, of the length of a Gaussian vector of covariance (3, 3).

    A scaled chi-square variable of the same mean and variance approximates the squared length
    (Satterthwaite 1946), exactly for a single axis and for equal ones.
    """
    eigenvalues = np.linalg.eigvalsh(covariance).clip(min=0)
    mean = eigenvalues.sum()
    squares = (eigenvalues**2).sum()
    if mean == 0:
        return 0.0
    return math.sqrt(float(squares / mean * _chi_square_90(mean**2 / squares)))


def _chi_square_90(freedom: float) -> float:
    """The bound, in nine cases of ten, of a chi-square variable of 1 to 3 degrees of freedom, by
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
