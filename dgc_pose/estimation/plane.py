"""Motions that a homography explains: the poses of a plane, and a camera that did not move.

A crop or a zoom of image 1, or a camera that turned and zoomed, gives a homography. An essential
matrix explains it as well: that of a plane before a camera that moved.
"""

from typing import NamedTuple

import numpy as np

from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import refine
from dgc_pose.geometry.homography import (
    fit_homography,
    fit_similarity,
    homography_poses,
    transfer_error,
)

PLANAR_SHARE = 0.85  # of inliers that one homography explains on a plane
# A homography's transfer error over the epipolar threshold. It takes in both coordinates of the
# noise of both images, the epipolar constraint one: the same noise needs a wider limit.
_TRANSFER_LIMIT = 1.75
_LOG_FOCAL_REACH = 1.5  # of ln f of camera 1 that is tried to either side
_LOG_FOCAL_STEP, _MIN_LOG_FOCAL_STEP = 0.3, 0.005  # at first, and at last


class Plane(NamedTuple):
    """The plane that a hypothesis' inliers may lie on."""

    share: float  # of the inliers that one homography explains
    H: np.ndarray | None  # (3, 3) the homography; None if there is none

    @property
    def is_plane(self) -> bool:
        """Whether the inliers lie on a plane."""
        return self.share >= PLANAR_SHARE


def fit_plane(problem: TwoViewProblem, pose: Hypothesis) -> Plane:
    """The plane of a hypothesis' inliers."""
    inliers = problem.subset(pose.inliers)
    limit = _TRANSFER_LIMIT * problem.threshold
    H = fit_homography(inliers.points1, inliers.points2, limit, problem.seed)
    if H is None:
        return Plane(0.0, None)
    error = transfer_error(inliers.points1, inliers.points2, H)
    return Plane(float((error < limit).mean()), H)


def planar_hypotheses(problem: TwoViewProblem, H: np.ndarray) -> list[Hypothesis]:
    """The poses that a plane's homography allows."""
    return [Hypothesis.of_pose(problem, R, t) for R, t in homography_poses(H)]


def best_planar(
    problem: TwoViewProblem, first: Hypothesis, H: np.ndarray, refined: bool
) -> Hypothesis:
    """The best of a hypothesis and of the poses that a plane's homography allows.

    On a plane the five-point solver has a family of near solutions; the homography allows two, each
    with both signs of t. refined: whether to refine them first.
    """
    others = planar_hypotheses(problem, H)
    if refined:
        others = [refine(problem, other) for other in others]
    return max([first, *others], key=lambda pose: (pose.num_in_front, pose.num_inliers))


class StillCamera(NamedTuple):
    """A camera that did not move."""

    share: float  # of the inliers that it explains
    R: np.ndarray  # (3, 3) its rotation


def still_camera(inliers: TwoViewProblem) -> StillCamera:
    """The camera that did not move and explains most inliers.

    Either image 2 is image 1 scaled, rolled and shifted, or the camera turned about its centre,
    each image with another focal length. inliers: normalised by the cameras as stated, whose
    principal points no fit has moved.
    """
    points, limit = (inliers.points1, inliers.points2), _TRANSFER_LIMIT * inliers.threshold
    homographies = [(np.eye(3), np.eye(3))]
    similarity = fit_similarity(*points, limit)
    if similarity is not None:
        roll = similarity / np.hypot(*similarity[:2, 0])
        roll[:, 2] = 0, 0, 1
        homographies.append((similarity, roll))
    H = fit_homography(*points, limit, inliers.seed)
    if H is not None:
        step = _LOG_FOCAL_STEP
        tried = np.arange(-_LOG_FOCAL_REACH, _LOG_FOCAL_REACH + step / 2, step)
        turns = {k: _turn(H, k) for k in tried}
        while True:
            best = min(turns, key=lambda k: np.median(transfer_error(*points, turns[k][0])))
            if step < _MIN_LOG_FOCAL_STEP:
                break
            step /= 2
            turns = {k: _turn(H, k) for k in (best, best - step, best + step)}
        homographies.append(turns[best])
    return max(
        (
            StillCamera(float((transfer_error(*points, still) < limit).mean()), R)
            for still, R in homographies
        ),
        key=lambda camera: camera.share,
    )


def _turn(H: np.ndarray, log_focal: float) -> tuple[np.ndarray, np.ndarray]:
    """The homography (3, 3) near H of a camera that turns, and its rotation. log_focal: of image 1,
    whose points have focal length 1; that of image 2 follows from H."""
    D1 = np.diag([np.exp(log_focal), np.exp(log_focal), 1.0])
    rows = H @ D1
    lengths = np.linalg.norm(rows, axis=1)
    focal2 = lengths[:2].mean() / lengths[2]
    D2 = np.diag([focal2, focal2, 1.0])
    U, _, Vt = np.linalg.svd(np.linalg.solve(D2, rows))
    R = U @ Vt
    R *= np.linalg.det(R)  # H has no sign
    return D2 @ R @ np.linalg.inv(D1), R
