"""Refinement of a model by robust least squares (Cauchy loss of the Sampson errors)."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.model import Model, error_scale
from dgc_pose.estimation.poselib_calls import MINIMAL, refine_pose
from dgc_pose.estimation.problem import TwoViewProblem

_ROUNDS = 3
_MIN_KEPT = 0.98  # of the inliers, or the fit is rejected


def refine(problem: TwoViewProblem, model: Model) -> Model:
    """The model after fits with the threshold as the scale of the loss, until the inliers stay the
    same.

    The inliers are chosen anew after each fit; three fits at most.
    """
    for _ in range(_ROUNDS):
        found = refit(problem, model)
        converged = np.array_equal(found.inliers, model.inliers)
        model = found
        if converged:
            break
    return model


def refit(problem: TwoViewProblem, model: Model, *, adapt_scale: bool = False) -> Model:
    """The model after least squares on its inliers in front of both cameras.

    adapt_scale: take the scale of the loss from the inliers' own errors, three times in turn,
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
        scale = error_scale(inliers, R, t) if adapt_scale else problem.threshold
        R, t = refine_pose(inliers.points1, inliers.points2, R, t, scale)
    found = Model.of_pose(problem, R, t)
    if not adapt_scale:
        # The epipolar error does not depend on the sign of the translation; the depths do.
        opposite = Model.of_pose(problem, R, -t)
        found = max((found, opposite), key=lambda m: (m.count, m.count_in_front))
    return found if found.count >= _MIN_KEPT * model.count else model
