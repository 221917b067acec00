"""The pose of a photograph in a model, from matches with database images of known pose and from
points of the model.

The pose in the world determines the epipolar geometry of each pair. RANSAC on the generalised
relative pose and on points of the model finds the starts; the best are fitted to all
correspondences together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import poselib

from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior
from dgc_pose.estimation.least_squares import (
    Slopes,
    block_sums,
    cauchy_slopes,
    jackknife,
    loss_terms,
    loss_width,
    match_variance,
    minimised,
    prior_information,
)
from dgc_pose.estimation.robust_fit import CAMERA, FOCAL, run_seeds
from dgc_pose.localization.correspondences import (
    Correspondences,
    PairCorrespondences,
    PointCorrespondences,
    WorldPose,
)
from dgc_pose.system.parallel import in_threads

_MIN_ITERATIONS = 100  # of a RANSAC run
_SAMPLED = 300  # matches of a pair that RANSAC draws from
_SCORED = 100  # matches of a pair for the comparison of starts
_FITTED = 400  # inliers of a pair in a fit; the errors of neighbours are correlated
_MIN_INLIERS = 8  # of a pair
_MAX_STARTS = 3  # number of starts that are fitted
_STEPS = 12
_CONVERGED = 1e-7  # for the distance along a line of sight, which errors hardly show
_MIN_KEPT = 0.95  # least score of a fit, over that of its start


def located(
    pairs: Sequence[PairCorrespondences],
    points: Sequence[PointCorrespondences],
    prior: IntrinsicsPrior,
    options: EstimationOptions,
    before: WorldPose | None = None,
) -> WorldPose | None:
    """The fitted pose with the best score; None if RANSAC finds no start.

    prior: of the references' camera, which is exact, and of the photograph's. before: the pose
    without the last pair; if the last pair supports it, it is the only start.
    """
    every: list[Correspondences] = [*pairs, *points]
    if before is not None and pairs[-1].supports(before):
        return fitted(every, before, prior)
    even = [part.subset(even_sample(len(part), _SCORED)) for part in every]
    starts = _starts(pairs, points, options)
    starts = sorted(starts, key=lambda pose: -score(even, pose))[:_MAX_STARTS]
    if not starts:
        return None
    fits = in_threads(lambda pose: fitted(every, pose, prior), starts)
    return max(fits, key=lambda pose: score(every, pose))


def score(every: Sequence[Correspondences], pose: WorldPose) -> float:
    """How well the correspondences fit a pose: the sum of max(1 - (error / threshold)^2, 0) over
    the points in front of the cameras."""
    total = 0.0
    for part in every:
        error, in_front = part.errors(pose)
        total += float(np.maximum(1 - (error / part.threshold) ** 2, 0)[in_front].sum())
    return total


def _starts(
    pairs: Sequence[PairCorrespondences],
    points: Sequence[PointCorrespondences],
    options: EstimationOptions,
) -> list[WorldPose]:
    # PoseLib never ends if no pair has five matches to draw.
    samples = [sample for sample in map(_explained, pairs) if len(sample) >= _MIN_INLIERS]
    runs: list[WorldPose | None] = []
    if len(samples) > 1:
        runs += in_threads(lambda seed: _pair_run(samples, options, seed), run_seeds(options))
    if sum(map(len, points)) >= _MIN_INLIERS:
        settings = {
            "max_iterations": options.iterations,
            "max_reproj_error": points[0].threshold * FOCAL,
            "seed": run_seeds(options)[0],
        }
        seen = np.concatenate([part.seen for part in points])
        world = np.concatenate([part.points for part in points])
        runs.append(
            _found(*poselib.estimate_absolute_pose(seen * FOCAL, world, CAMERA, settings, {}))
        )
    return [run for run in runs if run is not None]


def _pair_run(
    pairs: Sequence[PairCorrespondences], options: EstimationOptions, seed: int
) -> WorldPose | None:
    """The pose from one RANSAC run on the generalised relative pose (six-point solver), for pairs
    with at least five matches; None if it fails."""
    matches = []
    references = []
    for number, pair in enumerate(pairs):
        match = poselib.PairwiseMatches()
        reference = poselib.CameraPose()
        match.cam_id1 = number
        match.cam_id2 = 0
        match.x1 = pair.problem.points1 * FOCAL
        match.x2 = pair.problem.points2 * FOCAL
        reference.R = pair.R
        reference.t = -pair.R @ pair.centre
        matches.append(match)
        references.append(reference)
    threshold = float(np.median([pair.threshold for pair in pairs])) * FOCAL
    settings = {
        "max_iterations": options.iterations,
        "min_iterations": min(options.iterations, _MIN_ITERATIONS),
        "max_epipolar_error": threshold,
        "seed": seed,
    }
    at_origin = poselib.CameraPose()
    cameras = [CAMERA] * len(pairs)
    loss = {"loss_type": "TRUNCATED", "loss_scale": threshold}
    return _found(
        *poselib.estimate_generalized_relative_pose(
            matches, references, cameras, [at_origin], [CAMERA], settings, loss
        )
    )


def _found(pose: poselib.CameraPose, info: dict[str, float]) -> WorldPose | None:
    if info["num_inliers"] == 0 or not np.isfinite(pose.Rt).all():
        return None
    return WorldPose(pose.R, -pose.R.T @ pose.t, np.zeros(SIZE))


def _explained(pair: PairCorrespondences) -> PairCorrespondences:
    """An even sample of the matches that are inliers of a hypothesis of the pair."""
    chosen = np.flatnonzero(np.any([h.inliers_in_front for h in pair.hypotheses], axis=0))
    return pair.subset(chosen[even_sample(len(chosen), _SAMPLED)])


def even_sample(count: int, most: int) -> np.ndarray:
    """Indices of an even sample of at most `most` of `count` items."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)


def fitted(
    every: Sequence[Correspondences],
    pose: WorldPose,
    prior: IntrinsicsPrior,
    *,
    skewed: bool = False,
) -> WorldPose:
    """Fit the pose and the parameters of the camera: least Cauchy loss of the inliers, which are
    chosen anew before each step. Return the start if the fit has a much worse score. skewed:
    whether to fit a skew, too."""
    problem = _LocationFit(every, prior, skewed)
    found = minimised(problem, pose, _STEPS, descends=False, converged=_CONVERGED)
    return found if score(every, found) >= _MIN_KEPT * score(every, pose) else pose


@dataclass(frozen=True, eq=False)
class _LocationFit:
    """Least squares of a pose and a camera, on the inliers of each pose."""

    every: Sequence[Correspondences]
    prior: IntrinsicsPrior
    skewed: bool

    def linearised(self, pose: WorldPose) -> Slopes:
        count = 6 + len(self.prior) + self.skewed
        cost = 0.0
        hessian = np.zeros((count, count))
        gradient = np.zeros(count)
        for part, width in _inliers(self.every, pose, _FITTED):
            found = cauchy_slopes(*_slopes(part, pose, self.prior, skewed=self.skewed), width)
            cost += found.cost
            hessian += found.hessian
            gradient += found.gradient
        z = np.linalg.lstsq(self.prior.basis[SIZE:], pose.parameters, rcond=None)[0]
        return Slopes(cost, hessian, gradient).with_prior(np.append(z, [pose.skew] * self.skewed))

    def moved(self, pose: WorldPose, step: np.ndarray) -> WorldPose:
        return pose.moved(step, self.prior)


def _slopes(
    part: Correspondences, pose: WorldPose, prior: IntrinsicsPrior, *, skewed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The errors and the Jacobian of a part. skewed: with a last column, of the skew, which moves
    the principal point along x by y; up to the lens."""
    error, slopes = part.slopes(pose, prior)
    if not skewed:
        return error, slopes
    by_shift = slopes[:, 6:] @ np.linalg.pinv(prior.basis)[:, SIZE + 1]
    y = np.tile(part.seen[:, 1], len(error) // len(part))
    return error, np.column_stack([slopes, y * by_shift])


def _inliers(
    every: Sequence[Correspondences], pose: WorldPose, most: int | None = None
) -> Iterator[tuple[Correspondences, float]]:
    """Yield the inliers of each part that has enough, and the width of their loss. most: size of an
    even sample of the inliers of each part."""
    for part in every:
        error, in_front = part.errors(pose)
        chosen = np.flatnonzero(in_front & (error < part.threshold))
        if len(chosen) >= _MIN_INLIERS:
            width = loss_width(error[chosen], part.threshold)
            sample = chosen if most is None else chosen[even_sample(len(chosen), most)]
            yield part.subset(sample), width


def world_covariance(
    every: Sequence[Correspondences],
    pose: WorldPose,
    prior: IntrinsicsPrior,
    *,
    skewed: bool = False,
) -> np.ndarray | None:
    """Covariance (6 + M, 6 + M) of the rotation vector, radians, the centre, in the model's unit,
    and the basis of `prior`; None if the inliers do not determine them. skewed: with a last row and
    column, of the skew.

    By a jackknife over blocks of the photograph, each in all pairs at once, since errors within a
    block are correlated. With more than two sets of correspondences, it is averaged with a
    jackknife over whole sets, since each reference has errors of its own.
    """
    count = 6 + len(prior) + skewed
    information = prior_information(count, np.ones(count - 6))
    terms = []
    seen = []
    for part, width in _inliers(every, pose):
        error, slopes = _slopes(part, pose, prior, skewed=skewed)
        terms.append(loss_terms(error, slopes, width) / match_variance(width))
        seen.append(np.tile(part.seen, (len(error) // len(part), 1)))
    if not terms:
        return None
    groups = [block_sums(np.vstack(terms), np.vstack(seen), (0.0, 0.0))]
    if len(terms) > 2:
        groups.append(np.stack([each.sum(0) for each in terms]))
    total = information + groups[0][:, : count**2].sum(0).reshape(count, count)
    try:
        inverse = np.linalg.inv(total)
        covariance = np.mean([jackknife(total, sums) for sums in groups], axis=0)
    except np.linalg.LinAlgError:
        return None
    covariance += inverse @ information @ inverse
    return covariance if np.isfinite(covariance).all() else None
