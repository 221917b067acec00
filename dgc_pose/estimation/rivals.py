"""Other poses that explain the matches about as well: of a plane, of repeated structure, and of a
scene whose depth is mirrored.

- Two poses belong to the homography of a plane (Longuet-Higgins 1986).
- Where structure repeats, some matches agree on a pose one period off. Those that the model leaves
  over are searched for a second one.
- Seen from afar, a scene and its relief turned inside out look alike, and the camera seems to have
  rotated the other way (the bas-relief, or Necker, reversal).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.poselib_calls import sampled_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import planar_models, refine
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.triangulation import depths

DISTINCT_DEG = 10.0  # in R or t: poses nearer to each other count as one
_WORTH_REFINING = 0.3  # of the model's inliers, in front of both cameras
_LEAST_LEFT = 20  # matches left over that are searched
_FARTHEST = 1e6  # depth in baselines: beyond, there is no parallax to mirror
_LEAST_PLANAR = 0.5  # share of inliers that one homography explains


def rivals(
    problem: TwoViewProblem,
    model: Model,
    runs: Sequence[Model],
    homography: tuple[float, np.ndarray | None],
    options: EstimationOptions,
) -> list[Model]:
    """Refined models more than 10 degrees from `model` and from each other, that with most inliers
    in front of both cameras first.

    runs: the models of the runs. homography: the share of the model's inliers that it explains, and
    H (3, 3). Before refinement a rival has at least 0.3 of the model's inliers.
    """
    least = max(_WORTH_REFINING * model.count_in_front, 1)
    candidates = [*runs]
    share, H = homography
    if H is not None and share >= _LEAST_PLANAR:
        candidates += planar_models(problem, H)
    left = problem.subset(~model.inliers)
    if len(left) >= max(_LEAST_LEFT, least):
        seconds = sampled_models(left, replace(options, runs=1))
        candidates += [Model.of_pose(problem, second.R, second.t) for second in seconds]
    distinct = [model]
    for candidate in candidates:
        if candidate.count_in_front < least or known(candidate, distinct):
            continue
        # A bad fit of a pose that is known becomes that pose.
        refined = refine(problem, candidate) if options.refine else candidate
        if not known(refined, distinct):
            distinct.append(refined)
    # The reversal is not refined: the fit could lead back to the model.
    reversal = mirrored(problem, model)
    if reversal is not None and not known(reversal, distinct):
        distinct.append(reversal)
    return sorted(distinct[1:], key=lambda rival: -rival.count_in_front)


def mirrored(problem: TwoViewProblem, model: Model) -> Model | None:
    """The model of the scene with its relief turned inside out; None without inliers.

    Each point is mirrored at the plane through the middle of the scene that camera 1 sees face on.
    With the reflections M1 and M2 along the viewing rays to the middle, R becomes M2 R M1, and t
    becomes -M2 t: in images without perspective nothing changes.
    """
    inliers = problem.subset(model.inliers_in_front)
    depth, _ = depths(inliers.points1, inliers.points2, model.R, model.t)
    near = (depth > 0) & (depth < _FARTHEST)
    if not near.any():
        return None
    middle = homogeneous(np.median(inliers.points1[near], axis=0)[None])[0]
    middle = middle * np.median(depth[near])
    M1, M2 = (_reflection(point) for point in (middle, model.R @ middle + model.t))
    return Model.of_pose(problem, M2 @ model.R @ M1, -M2 @ model.t)


def _reflection(direction: np.ndarray) -> np.ndarray:
    """The reflection (3, 3) that reverses a direction (3,)."""
    unit = direction / np.linalg.norm(direction)
    return np.eye(3) - 2 * np.outer(unit, unit)


def known(candidate: Model, models: Iterable[Model]) -> bool:
    """Whether a model is within 10 degrees of one of these."""
    return any(candidate.angle_to(other.R, other.t) <= DISTINCT_DEG for other in models)
