"""Refinement of a model by robust least squares (Cauchy loss of the Sampson errors)."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.model import Model, error_scale
from dgc_pose.estimation.poselib_calls import MINIMAL, refine_pose
from dgc_pose.estimation.problem import TwoViewProblem

_ROUNDS = 3
_MIN_KEPT = 0.98  # of the inliers, or the fit is rejected


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
    fitted = Model.of_pose(problem, R, t)
    if not adapt_scale:
        # The epipolar error does not depend on the sign of the translation; the depths do.
        opposite = Model.of_pose(problem, R, -t)
        fitted = max((fitted, opposite), key=lambda m: (m.count, m.count_in_front))
    return fitted if fitted.count >= _MIN_KEPT * model.count else model
