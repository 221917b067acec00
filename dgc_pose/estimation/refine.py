"""Refinement of a hypothesis by robust least squares: the Cauchy loss of the Sampson errors, by
PoseLib."""

import numpy as np
import poselib

from dgc_pose.estimation.hypothesis import Hypothesis, pose_error_scale
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import CAMERA, FOCAL, MINIMAL

_ROUNDS = 3
_MIN_KEPT = 0.98  # of the inliers, or the fit is rejected


def refine(problem: TwoViewProblem, start: Hypothesis) -> Hypothesis:
    """The hypothesis after at most three fits with the threshold as the scale of the loss, until
    the inliers, chosen anew after each fit, stay the same."""
    pose = start
    for _ in range(_ROUNDS):
        before, pose = pose, refit(problem, pose)
        if np.array_equal(pose.inliers, before.inliers):
            break
    return pose


def refit(problem: TwoViewProblem, start: Hypothesis, *, adapt_scale: bool = False) -> Hypothesis:
    """The hypothesis after least squares on its inliers in front of both cameras.

    adapt_scale: take the scale of the loss from the inliers' errors, three times in turn,
    instead of the threshold. Most inliers are far more accurate than the threshold, and the others
    would bias the pose. Returns `start` itself if it has no more than five such inliers, or if the
    fit would lose more than one inlier in fifty.
    """
    # An inlier behind a camera is an outlier that happens to lie near its epipolar line.
    inliers = problem.subset(start.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return start
    R, t = start.R, start.t
    for _ in range(_ROUNDS if adapt_scale else 1):
        scale = pose_error_scale(inliers, R, t) if adapt_scale else problem.threshold
        R, t = least_squares_pose(inliers, R, t, scale)
    fitted = Hypothesis.of_pose(problem, R, t)
    if not adapt_scale:
        # The epipolar error does not depend on the sign of the translation; the depths do.
        opposite = Hypothesis.of_pose(problem, R, -t)
        fitted = max((fitted, opposite), key=lambda pose: (pose.num_inliers, pose.num_in_front))
    return fitted if fitted.num_inliers >= _MIN_KEPT * start.num_inliers else start


def least_squares_pose(
    inliers: TwoViewProblem, R: np.ndarray, t: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """R and unit t of least Cauchy loss, from a start. scale: of the loss, in the points' unit."""
    start = poselib.CameraPose()
    start.R, start.t = R, t
    options = {"loss_type": "CAUCHY", "loss_scale": scale * FOCAL, "max_iterations": 100}
    points = inliers.points1 * FOCAL, inliers.points2 * FOCAL
    pose, _ = poselib.refine_relative_pose(*points, start, CAMERA, CAMERA, options)
    length = np.linalg.norm(pose.t)
    if length < 1e-12 or not np.isfinite(pose.R).all():
        return R, t
    return pose.R, pose.t / length
