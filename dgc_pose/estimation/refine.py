"""Refinement of a model by robust least squares (Cauchy loss of the Sampson errors), and the poses
that the homography of a plane allows."""

import numpy as np

from dgc_pose.estimation.model import Model, pose_error_scale
from dgc_pose.estimation.poselib_calls import MINIMAL, refine_pose
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.homography import fit_homography, homography_poses, transfer_error

_ROUNDS = 3
PLANAR_SHARE = 0.85  # of inliers that one homography explains on a plane
_MIN_KEPT = 0.98  # of the inliers, or the fit is rejected
# A homography's transfer error over the epipolar threshold. It takes in both coordinates of the
# noise of both images, the epipolar constraint one: the same noise needs a wider limit.
TRANSFER_LIMIT = 1.75


def refine(problem: TwoViewProblem, model: Model) -> Model:
    """The model after at most three fits with the threshold as the scale of the loss, until the
    inliers, chosen anew after each fit, stay the same."""
    for _ in range(_ROUNDS):
        before, model = model, refit(problem, model)
        if np.array_equal(model.inliers, before.inliers):
            break
    return model


def refit(problem: TwoViewProblem, model: Model, *, adapt_scale: bool = False) -> Model:
    """The model after least squares on its inliers in front of both cameras.

    adapt_scale: take the scale of the loss from the inliers' errors, three times in turn,
    instead of the threshold. Most inliers are far more accurate than the threshold, and the others
    would bias the pose. Returns `model` itself if it has no more than five such inliers, or if the
    fit would lose more than one inlier in fifty.
    """
    # An inlier behind a camera is an outlier that happens to lie near its epipolar line.
    inliers = problem.subset(model.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return model
    R, t = model.R, model.t
    for _ in range(_ROUNDS if adapt_scale else 1):
        scale = pose_error_scale(inliers, R, t) if adapt_scale else problem.threshold
        R, t = refine_pose(inliers.points1, inliers.points2, R, t, scale)
    fitted = Model.of_pose(problem, R, t)
    if not adapt_scale:
        # The epipolar error does not depend on the sign of the translation; the depths do.
        opposite = Model.of_pose(problem, R, -t)
        fitted = max((fitted, opposite), key=lambda m: (m.count, m.count_in_front))
    return fitted if fitted.count >= _MIN_KEPT * model.count else model


def planar_share(problem: TwoViewProblem, model: Model) -> tuple[float, np.ndarray | None]:
    """The share of a model's inliers that one homography explains, and the homography (3, 3)."""
    inliers = problem.subset(model.inliers)
    limit = TRANSFER_LIMIT * problem.threshold
    H = fit_homography(inliers.points1, inliers.points2, limit, problem.seed)
    if H is None:
        return 0.0, None
    error = transfer_error(inliers.points1, inliers.points2, H)
    return float((error < limit).mean()), H


def planar_models(problem: TwoViewProblem, H: np.ndarray) -> list[Model]:
    """The models of the poses that a plane's homography allows."""
    return [Model.of_pose(problem, R, t) for R, t in homography_poses(H)]


def best_planar_model(problem: TwoViewProblem, model: Model, H: np.ndarray, refined: bool) -> Model:
    """The best of a model and of the poses that a plane's homography allows.

    On a plane the five-point solver has a family of near solutions; the homography allows two, each
    with both signs of t. refined: whether to refine them first.
    """
    others = planar_models(problem, H)
    if refined:
        others = [refine(problem, other) for other in others]
    return max([model, *others], key=lambda m: (m.count_in_front, m.count))
