"""Other poses that explain the matches about as well: of a plane, of repeated structure, and of a
scene whose depth is mirrored.

- Two poses belong to the homography of a plane (Longuet-Higgins 1986).
- Where structure repeats, some matches agree on a pose one period off. Those that the model leaves
  over are searched for a second one.
- Seen from afar, a scene and its relief turned inside out look alike, and the camera seems to have
  rotated the other way (the bas-relief, or Necker, reversal).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.plane import planar_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import sampled_models
from dgc_pose.estimation.refine import refine
from dgc_pose.geometry.triangulation import depths

DISTINCT_DEG = 10.0  # in R or t: poses nearer to each other count as one
_WORTH_REFINING = 0.3  # of the model's inliers, in front of both cameras
_LEAST_LEFT = 20  # matches left over that are searched
_LEAST_PLANAR = 0.5  # share of inliers that one homography explains
_MOST_POINTS = 500  # that the mirrored scene is fitted to


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
    H (3, 3). Their inliers need not be many: at least a third of the model's before refinement.
    """
    least = max(_WORTH_REFINING * model.count_in_front, 1)
    found: list[Model] = []
    for candidate in _candidates(problem, model, runs, homography, options):
        if candidate.count_in_front < least or _known(candidate, [model, *found]):
            continue
        refined = refine(problem, candidate) if options.refine else candidate
        if not _known(refined, [model, *found]):
            found.append(refined)
    return sorted(found, key=lambda other: -other.count_in_front)


def mirrored(problem: TwoViewProblem, model: Model) -> Model | None:
    """The model of the scene with its relief turned inside out; None if there is no such pose.

    Depths are mirrored at the median of their inverses, and camera 2 is resected from the mirrored
    points (SQPnP, Terzakis and Lourakis 2020).
    """
    inliers = problem.subset(model.inliers_in_front)
    chosen = np.random.default_rng(problem.seed).permutation(len(inliers))[:_MOST_POINTS]
    points1, points2 = inliers.points1[chosen], inliers.points2[chosen]
    depth, _ = depths(points1, points2, model.R, model.t)
    inverse = 1 / depth
    inverse = 2 * np.median(inverse) - inverse if len(inverse) else inverse
    known = np.isfinite(inverse) & (inverse > 0)
    if known.sum() < 6:
        return None
    points = np.column_stack([points1, np.ones(len(points1))])[known] / inverse[known][:, None]
    try:
        done, rotation, t = cv2.solvePnP(
            points, points2[known], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error:  # degenerate points
        return None
    length = np.linalg.norm(t)
    if not done or not np.isfinite(t).all() or length < 1e-12:
        return None
    return Model.of_pose(problem, cv2.Rodrigues(rotation)[0], t[:, 0] / length)


def _candidates(
    problem: TwoViewProblem,
    model: Model,
    runs: Iterable[Model],
    homography: tuple[float, np.ndarray | None],
    options: EstimationOptions,
) -> Iterator[Model]:
    yield from runs
    share, H = homography
    if H is not None and share >= _LEAST_PLANAR:
        yield from planar_models(problem, H)
    other = mirrored(problem, model)
    if other is not None:
        yield other
    left = problem.subset(~model.inliers)
    if len(left) >= max(_LEAST_LEFT, _WORTH_REFINING * model.count_in_front):
        for found in sampled_models(left, replace(options, runs=1))[:1]:
            yield Model.of_pose(problem, found.R, found.t)


def _known(candidate: Model, models: Iterable[Model]) -> bool:
    return any(candidate.angle_to(other.R, other.t) <= DISTINCT_DEG for other in models)
