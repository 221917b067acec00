"""Planar scenes: how many inliers a homography explains, and the poses that it allows."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import refine
from dgc_pose.geometry.homography import fit_homography, homography_poses, transfer_error

# A homography's transfer error over the epipolar threshold. It takes in both coordinates of the
# noise of both images, the epipolar constraint one: the same noise needs a wider limit.
_LIMIT = 1.75


def planar_share(problem: TwoViewProblem, model: Model) -> tuple[float, np.ndarray | None]:
    """The share of a model's inliers that one homography explains, and the homography (3, 3)."""
    inliers = problem.subset(model.inliers)
    limit = _LIMIT * problem.threshold
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
