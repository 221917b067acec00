"""The covariance of a pose, and the error that it stays below nine times in ten.

Errors of dense matches are correlated: neighbours lie on the same misplaced surface, so a thousand
of them carry little more information than a few. The usual covariance takes all matches for
independent and is several times too small. Here it is the sum of two parts. For the first, image 2
is divided into blocks, and the pose's spread is measured by leaving out one block after the other
(the delete-a-group jackknife, Kott 2001), so that correlated errors are left out together. The
blocks are few, and one may hold nearly all information: the second part is the usual covariance,
with a tenth of the matches.

Cameras that are not exact are parameters as the pose is. Their prior is information that no block
holds: the second part has it.
"""

import math
from dataclasses import dataclass

import numpy as np

from dgc_pose.estimation.camera_spread import EXACT, FOCALS, CameraSpread, error_slopes
from dgc_pose.estimation.hypothesis import ALIKE, EFFICIENT, Hypothesis, pose_error_scale
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import MINIMAL

BLOCKS = 3  # along the longer side of the inliers in image 2; see docs/experiments.md
SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of the blocks, in blocks
NORMAL_90 = 1.6449  # standard deviations that a normal variable is off nine times in ten
# Share of the whole information that is kept when a block is left out: of a dense map a block may
# have nearly all of it, see docs/experiments.md; else only so much that the rest is regular.
_KEPT, _REGULAR = 0.1, 1e-9


@dataclass(frozen=True, eq=False)
class Covariance:
    """The covariance of a pose and of the deviations of its cameras."""

    pose: np.ndarray  # (6, 6), rad^2, of rank 5: see `pose_covariance`
    cameras: np.ndarray  # (10, 10), see `CameraSpread`; 0 of exact ones

    @property
    def focal_stds(self) -> tuple[float, float]:
        """Standard deviations of ln f of both cameras."""
        first, second = np.sqrt(np.diag(self.cameras)[FOCALS]).tolist()
        return first, second

    @property
    def focal_90_percent(self) -> float | None:
        """The error of ln f of the less certain camera that nine in ten stay below, per cent;
        None if both focal lengths are exact."""
        return 100 * NORMAL_90 * max(self.focal_stds) or None


def pose_covariance(
    problem: TwoViewProblem, pose: Hypothesis, spread: CameraSpread = EXACT, *, fitted: bool = True
) -> Covariance | None:
    """Covariance (6, 6), rad^2, of the rotation vector and of the unit translation.

    Of the pose that minimises the Cauchy loss, at the errors' own scale, of the Sampson errors of
    the inliers in front of both cameras. In camera 2's axes: the true pose is exp([w]x) R and t + d
    for a (w, d) of this covariance. d is perpendicular to t, so the rank is 5. None if the inliers
    do not determine the pose. spread: of the cameras that normalised the problem. fitted: whether
    these were fitted to the matches together with the pose, or are known that well from elsewhere.
    """
    inliers = problem.subset(pose.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return None
    error, slopes, tangent = error_slopes(inliers, pose.R, pose.t, spread)
    by_cameras = slopes[:, 5:]
    if not fitted:
        slopes = slopes[:, :5]
    scale = pose_error_scale(inliers, pose.R, pose.t)
    squared = (error / scale) ** 2
    # Negative for errors beyond the loss's inflection; a match must not count as negative evidence.
    curvature = np.maximum(1 - squared, 0) / (1 + squared) ** 2
    gradients = slopes * (error / (1 + squared))[:, None]
    information = (slopes * curvature[:, None])[:, :, None] * slopes[:, None]
    count = slopes.shape[1]
    terms = np.column_stack([information.reshape(-1, count**2), gradients])
    total = information.sum(0)
    variance = ALIKE * (scale / EFFICIENT) ** 2  # of a match: the information is in its unit
    prior = variance * np.diag([*np.zeros(5), *np.ones(count - 5)])
    # The blocks show all of the errors of key points, which err independently of their neighbours.
    kept, beside = (_REGULAR, prior) if problem.key_points else (_KEPT, prior + total)
    total = total + prior
    covariances = []
    try:
        for shift in SHIFTS:
            sums = block_sums(terms, inliers.points2, shift)
            covariances.append(jackknife(total, sums, kept))
        inverse = np.linalg.inv(total)
        covariance = np.mean(covariances, axis=0) + variance * inverse @ beside @ inverse
        if len(spread) and not fitted:  # the pose moves with the cameras
            moved = np.linalg.solve(total, (slopes * curvature[:, None]).T @ by_cameras)
            covariance += moved @ moved.T
    except np.linalg.LinAlgError:
        return None
    expand = np.zeros((6, 5))
    expand[:3, :3], expand[3:, 3:] = np.eye(3), tangent
    of_pose = expand @ covariance[:5, :5] @ expand.T
    of_cameras = covariance[5:, 5:] if fitted else np.eye(len(spread))
    cameras = spread.basis @ of_cameras @ spread.basis.T
    if not (np.isfinite(of_pose).all() and np.isfinite(cameras).all()):
        return None
    return Covariance(of_pose, cameras)


def error_radii_deg(covariance: np.ndarray | None) -> tuple[float | None, float | None]:
    """`error_radius_deg` of the rotation and of the translation of a pose's covariance (6, 6)."""
    if covariance is None:
        return None, None
    return error_radius_deg(covariance[:3, :3]), error_radius_deg(covariance[3:, 3:])


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


def jackknife(total: np.ndarray, sums: np.ndarray, kept: float = _REGULAR) -> np.ndarray:
    """The covariance (P, P) of P parameters by leaving out one group after the other.

    total: their information (P, P), with any prior's. sums: (G, P * P + P) of each group, its
    information and the gradient of its loss. kept: share of `total` beside the rest. Raises
    LinAlgError if the rest determines none.
    """
    count, groups = len(total), len(sums)
    left_out = sums[:, : count**2].reshape(-1, count, count)
    gradient = sums[:, count**2 :, None]
    moves = np.linalg.solve((1 + kept) * total - left_out, gradient)[:, :, 0]
    covariance: np.ndarray = (groups - 1) / groups * moves.T @ moves
    return covariance


def block_sums(terms: np.ndarray, points: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Sums (B, M) of terms (N, M) over square blocks of points (N, 2), empty blocks left out.

    No matrix product: the order of its sums depends on the number of threads.
    """
    low, high = points.min(0), points.max(0)
    # Slightly more than the span, or the farthest point would be alone in a block.
    side = max((1 + 1e-9) * float((high - low).max()), np.finfo(float).tiny) / BLOCKS
    column, row = np.floor((points - low) / side + shift).astype(int).T
    block = column + (BLOCKS + 1) * row
    order = np.argsort(block, kind="stable")
    return np.add.reduceat(terms[order], np.unique(block[order], return_index=True)[1])
