"""The pose of a photograph from its matches with several references of known poses.

Each pair has an epipolar geometry that the pose in the world determines. RANSAC on the generalised
relative pose, on points of the model, and the hypotheses of the single pairs, whose lines of sight
meet in the centre, are starts; the best of them are fitted to the matches of all pairs together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import cv2
import numpy as np

from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior
from dgc_pose.estimation.least_squares import (
    CORRELATED,
    EFFICIENT,
    block_sums,
    jackknife,
    loss_width,
)
from dgc_pose.estimation.robust_fit import (
    RigidPose,
    absolute_pose,
    generalized_pose,
    run_seeds,
)
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.localization.sights import PointSight, Sight, WorldPose
from dgc_pose.system.threads import in_threads

AnySight = Sight | PointSight
Part = tuple[AnySight, float]  # inliers, and the scale of their errors
_SAMPLED = 300  # matches of a pair that RANSAC draws from
_SCORED = 100  # matches of a pair that starts are compared by
_FITTED = 400  # inliers of a pair that a pose is fitted to: neighbours err alike
_MIN_INLIERS = 8  # of a pair
_MAX_STARTS = 3  # that are fitted
_ALIKE_DEG = 15.0  # between the rotations of two pairs that may be of one pose
_PARALLEL = 5e-5  # half of the angle of two rays, radians, up to which they do not meet
_STEPS, _CONVERGED = 12, 1e-6
_MIN_KEPT = 0.95  # of the score, or a fit is rejected


def located(
    sights: Sequence[Sight],
    points: Sequence[PointSight],
    spread: IntrinsicsPrior,
    options: EstimationOptions,
    before: WorldPose | None = None,
) -> WorldPose | None:
    """The pose that most matches agree with, fitted to them; None without a start.

    spread: of the references' camera, which is exact, and of the photograph's. before: the pose
    without the last of the sights: if that agrees with it, it is the start.
    """
    every: list[AnySight] = [*sights, *points]
    if before is not None and sights[-1].agrees(before):
        return fitted(every, before, spread)
    even = [sight.subset(_even(len(sight), _SCORED)) for sight in every]
    starts = _starts(sights, points, options)
    starts = sorted(starts, key=lambda pose: -score(even, pose))[:_MAX_STARTS]
    if not starts:
        return None
    fits = in_threads(lambda pose: fitted(every, pose, spread), starts)
    return max(fits, key=lambda pose: score(every, pose))


def score(sights: Sequence[AnySight], pose: WorldPose) -> float:
    """How well the matches in front of the cameras agree: their number less their truncated
    squared errors over the squared threshold."""
    total = 0.0
    for sight in sights:
        error, in_front = sight.errors(pose)
        total += float(np.maximum(1 - (error / sight.threshold) ** 2, 0)[in_front].sum())
    return total


def _starts(
    sights: Sequence[Sight], points: Sequence[PointSight], options: EstimationOptions
) -> list[WorldPose]:
    poses = [pose for pair in combinations(sights, 2) for pose in _of_two(*pair)]
    # PoseLib draws five matches of a pair without end, if no pair has them.
    samples = [sample for sample in map(_explained, sights) if len(sample) >= _MIN_INLIERS]
    runs: list[RigidPose | None] = []
    if len(samples) > 1:
        problems = [sample.problem for sample in samples]
        references = [(sample.R, sample.centre) for sample in samples]
        runs += in_threads(
            lambda seed: generalized_pose(problems, references, options, seed), run_seeds(options)
        )
    if sum(map(len, points)) >= _MIN_INLIERS:
        places = np.concatenate([sight.places for sight in points])
        world = np.concatenate([sight.points for sight in points])
        runs.append(absolute_pose(places, world, points[0].threshold, options))
    return [*poses, *(WorldPose(*run, np.zeros(SIZE)) for run in runs if run is not None)]


def _of_two(first: Sight, second: Sight) -> list[WorldPose]:
    """The poses whose centre is where the lines of sight of two pairs come nearest to each
    other."""
    poses = []
    for one, two in product(first.hypotheses, second.hypotheses):
        R = one.R @ first.R
        if rotation_angle_deg(two.R @ second.R @ R.T) > _ALIKE_DEG:
            continue
        ray1, ray2 = -(one.R @ first.R).T @ one.t, -(two.R @ second.R).T @ two.t
        lengths, _, rank, _ = np.linalg.lstsq(
            np.column_stack([ray1, -ray2]), second.centre - first.centre, rcond=_PARALLEL
        )
        if rank == 2 and (lengths > 0).all():
            end1, end2 = first.centre + lengths[0] * ray1, second.centre + lengths[1] * ray2
            poses.append(WorldPose(R, (end1 + end2) / 2, np.zeros(SIZE)))
    return poses


def _explained(sight: Sight) -> Sight:
    """The matches that a hypothesis of the pair explains, an even sample."""
    chosen = np.flatnonzero(np.any([h.inliers_in_front for h in sight.hypotheses], axis=0))
    return sight.subset(chosen[_even(len(chosen), _SAMPLED)])


def _even(count: int, most: int) -> np.ndarray:
    """Indices of an even sample of at most so many."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)


def fitted(sights: Sequence[AnySight], pose: WorldPose, spread: IntrinsicsPrior) -> WorldPose:
    """The pose of least Cauchy loss of the Sampson errors of the inliers in front of the cameras,
    and the deviations of the camera: Gauss-Newton, with weights from the loss, and inliers chosen
    anew before each step. The pose itself if the fit has a much worse score."""
    start = pose
    for _ in range(_STEPS):
        z = np.linalg.lstsq(spread.basis[SIZE:], pose.deviations, rcond=None)[0]
        information = np.diag([*np.zeros(6), *np.ones(len(spread))])
        gradient = np.concatenate([np.zeros(6), z])
        for part in _parts(sights, pose, _FITTED):
            slopes, weights, gradients = _linearised(part, pose, spread)
            information = information + (slopes * weights[:, None]).T @ slopes
            gradient = gradient + gradients.sum(0)
        step = np.linalg.lstsq(information, -gradient, rcond=None)[0]
        deviations = pose.deviations + (spread.basis @ step[6:])[SIZE:]
        R = cv2.Rodrigues(step[:3])[0] @ pose.R
        pose = WorldPose(R, pose.centre + step[3:6], deviations)
        if abs(step @ gradient) < _CONVERGED:
            break
    return pose if score(sights, pose) >= _MIN_KEPT * score(sights, start) else start


def _parts(sights: Sequence[AnySight], pose: WorldPose, most: int | None = None) -> list[Part]:
    """The inliers of each pair that has enough, and the scale of their errors. most: of a pair, an
    even sample."""
    parts = []
    for sight in sights:
        error, in_front = sight.errors(pose)
        chosen = np.flatnonzero(in_front & (error < sight.threshold))
        if len(chosen) >= _MIN_INLIERS:
            scale = loss_width(error[chosen], sight.threshold)
            sample = chosen if most is None else chosen[_even(len(chosen), most)]
            parts.append((sight.subset(sample), scale))
    return parts


def _linearised(
    part: Part, pose: WorldPose, spread: IntrinsicsPrior, *, curvature: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives (N, 6 + M) of the errors, their weights (N,), and the gradients (N, 6 + M) of the
    loss. curvature: weights by the loss's second derivative, and not those of a step."""
    sight, scale = part
    error, slopes = sight.slopes(pose, spread)
    squared = (error / scale) ** 2
    weights = (EFFICIENT / scale) ** 2 / CORRELATED / (1 + squared)
    gradients = slopes * (weights * error)[:, None]
    if curvature:
        weights = weights * np.maximum(1 - squared, 0) / (1 + squared)
    return slopes, weights, gradients


def world_covariance(
    sights: Sequence[AnySight], pose: WorldPose, spread: IntrinsicsPrior
) -> np.ndarray | None:
    """Covariance (6 + M, 6 + M) of the rotation vector, radians, the centre, in the model's unit,
    and the basis of `spread`; None if the inliers do not determine them.

    By the delete-a-group jackknife, as `estimation.covariance` has it: over blocks of the
    photograph, each in all pairs at once, as their errors there are alike; and over whole pairs, if
    there are more than two, as references have errors of their own.
    """
    count = 6 + len(spread)
    prior = np.diag([*np.zeros(6), *np.ones(len(spread))])
    terms, places = [], []
    for part in _parts(sights, pose):
        slopes, weights, gradients = _linearised(part, pose, spread, curvature=True)
        information = (slopes * weights[:, None])[:, :, None] * slopes[:, None]
        terms.append(np.column_stack([information.reshape(-1, count**2), gradients]))
        places.append(np.tile(part[0].places, (len(slopes) // len(part[0]), 1)))
    if not terms:
        return None
    groups = [block_sums(np.vstack(terms), np.vstack(places), (0.0, 0.0))]
    if len(terms) > 2:
        groups.append(np.stack([of_pair.sum(0) for of_pair in terms]))
    total = prior + groups[0][:, : count**2].sum(0).reshape(count, count)
    try:
        inverse = np.linalg.inv(total)
        covariance = np.mean([jackknife(total, sums) for sums in groups], axis=0)
    except np.linalg.LinAlgError:
        return None
    covariance += inverse @ prior @ inverse
    return covariance if np.isfinite(covariance).all() else None
