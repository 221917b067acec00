"""The measurements that the verdict on a model rests on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.estimation.chance import chance_ratio, log10_false_alarms
from dgc_pose.estimation.covariance import error_radius_deg
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.triangulation import epipolar_angles, triangulation_angles_deg, unit_rays

_ROTATION_LIMIT = 6.0  # residual angle of a match under a rotation, over the epipolar threshold
_ROTATION_ROUNDS = 10
_NORMAL_MEDIAN = 0.6745  # of |x|, and of |(x, y)|, of Gaussian noise with a deviation of 1
_RAYLEIGH_MEDIAN = 1.1774
_MIN_ERROR = 0.05  # of the threshold: matches are not trusted to be more accurate than that


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the verdict rests on."""

    num_inliers: int
    inlier_ratio: float  # of all matches
    chance_ratio: float  # the same model's, of the same points paired wrongly
    log10_false_alarms: float  # number of models with so many inliers expected in random matches
    cheirality_ratio: float  # share of inliers in front of both cameras
    rotation: np.ndarray  # (3, 3) the rotation that explains most matches without a translation
    num_rotation_inliers: int  # matches that it explains, on which the parallax is measured
    rotation_share: float  # the same, over the inliers
    strict_rotation_share: float  # share of inliers that it explains within the threshold itself
    parallax: float  # spread of the motion left by it, over the spread of the epipolar error
    median_triangulation_angle_deg: float  # of the inliers
    homography_ratio: float  # share of inliers that one homography explains
    collinear: bool  # the inliers of either image lie on one line
    # Grid cells with inliers, in the image with fewer of them; None for key points.
    occupied_cells: int | None
    rotation_error_90_deg: float | None  # nine times in ten the rotation error is below; or unknown


def gather(
    problem: TwoViewProblem,
    model: Model,
    homography_ratio: float,
    covariance: np.ndarray | None = None,
) -> Evidence:
    """The evidence for and against a model of the problem's matches.

    covariance: of its pose, see `pose_covariance`.
    """
    threshold = problem.threshold
    kept = model.inliers
    inliers = problem.subset(kept)
    count = max(len(inliers), 1)
    chance = chance_ratio(problem, model.E)
    rotation = robust_rotation(inliers)
    # Over all matches: the inliers were chosen for a small error across the epipolar lines.
    rays1, rays2 = unit_rays(problem.points1), unit_rays(problem.points2)
    motion = np.linalg.norm(rays1 @ rotation.T - rays2, axis=1)
    explained = motion < _ROTATION_LIMIT * threshold
    rotated = problem.subset(explained)
    across = epipolar_angles(rotated.points1, rotated.points2, model.E)
    angles = triangulation_angles_deg(inliers.points1, inliers.points2, model.R)
    return Evidence(
        num_inliers=model.count,
        inlier_ratio=float(kept.mean()),
        chance_ratio=chance,
        log10_false_alarms=log10_false_alarms(len(problem), model.count, chance),
        cheirality_ratio=float(model.in_front[kept].mean()) if kept.any() else 0.0,
        rotation=rotation,
        num_rotation_inliers=len(rotated),
        rotation_share=len(rotated) / count,
        # The motion has the noise of both images, the epipolar error that of one: sqrt(2) apart.
        strict_rotation_share=float((motion[kept] < np.sqrt(2) * threshold).sum() / count),
        parallax=_parallax(motion[explained], across, _MIN_ERROR * threshold),
        median_triangulation_angle_deg=float(np.median(angles)) if len(angles) else 0.0,
        homography_ratio=homography_ratio,
        collinear=min(_width(inliers.points1), _width(inliers.points2)) < 2 * threshold,
        occupied_cells=_occupied_cells(inliers),
        rotation_error_90_deg=None if covariance is None else error_radius_deg(covariance[:3, :3]),
    )


def robust_rotation(problem: TwoViewProblem) -> np.ndarray:
    """The rotation (3, 3) that takes rays 1 to rays 2.

    Least squares on all matches, then on those within twice the threshold or on the better half,
    whichever are more, until they stay the same. The identity for fewer than two matches.
    """
    rays1, rays2 = unit_rays(problem.points1), unit_rays(problem.points2)
    kept = np.ones(len(rays1), dtype=bool)
    R = np.eye(3)
    for _ in range(_ROTATION_ROUNDS):
        if kept.sum() < 2:
            break
        # The least squares depend on the rays through this matrix alone, and three rows are quicker
        # to align than all rays.
        correlation = rays1[kept].T @ rays2[kept]
        R = Rotation.align_vectors(correlation, np.eye(3))[0].as_matrix()
        distance = np.linalg.norm(rays1 @ R.T - rays2, axis=1)
        following = distance <= max(2 * problem.threshold, float(np.median(distance)))
        if np.array_equal(following, kept):
            break
        kept = following
    return R


def _occupied_cells(problem: TwoViewProblem) -> int | None:
    """Grid cells with matches, in the image with fewer of them; None for key points."""
    if problem.cells is None:
        return None
    sides = zip((problem.points1, problem.points2), problem.cells, strict=True)
    cells = (np.floor(points / side).astype(int) for points, side in sides)
    return min(len(np.unique(cell, axis=0)) for cell in cells)


def _parallax(motion: np.ndarray, across: np.ndarray, least: float) -> float:
    """Spread of the motion (N,) left by a rotation, over that of the epipolar error (N,).

    Each is a median scaled to a standard deviation of Gaussian noise, in two dimensions and in one.
    Noise moves points along their epipolar lines as much as across them, so a pure rotation gives
    1, or a little more if the essential matrix fits the noise of few matches; a real translation
    gives more. The error counts as `least` at least: exact copies have only rounding errors.
    """
    if not len(motion):
        return 0.0
    left, error = np.median(motion) / _RAYLEIGH_MEDIAN, np.median(across) / _NORMAL_MEDIAN
    return float(left / max(error, least))


def _width(points: np.ndarray) -> float:
    """Standard deviation of points (N, 2) across the line that fits them best."""
    if len(points) < 2:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[0], 0.0)))
