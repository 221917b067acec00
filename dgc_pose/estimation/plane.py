"""Motions that a homography explains: the poses of a plane, and a camera that did not move.

A crop or a zoom of image 1, or a camera that turned and zoomed, gives a homography. An essential
matrix explains it as well: that of a plane before a camera that moved.
"""

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


def fit_plane(problem: TwoViewProblem, pose: Hypothesis) -> tuple[float, np.ndarray | None]:
    """The share of a hypothesis' inliers that one homography explains, and this (3, 3); 0 and None
    if there is none. From `PLANAR_SHARE` on they lie on a plane."""
    inliers = problem.subset(pose.inliers)
    limit = _TRANSFER_LIMIT * problem.threshold
    H = fit_homography(inliers.points1, inliers.points2, limit, problem.seed)
    if H is None:
        return 0.0, None
    error = transfer_error(inliers.points1, inliers.points2, H)
    return float((error < limit).mean()), H


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


def still_camera(inliers: TwoViewProblem) -> tuple[float, np.ndarray]:
    """The largest share of inliers that a camera explains which did not move, and its rotation
    (3, 3).

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
    shares = [float((transfer_error(*points, H) < limit).mean()) for H, _ in homographies]
    best = int(np.argmax(shares))
    return shares[best], homographies[best][1]


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
