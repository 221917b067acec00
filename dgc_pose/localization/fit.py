"""The pose of a photograph in a model, from matches with database images of known pose and from
points of the model.

The pose in the world determines the epipolar geometry of each pair. RANSAC on the generalised
relative pose and on points of the model finds the starts; the best are fitted to all
correspondences together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import poselib

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.intrinsics_prior import (
    SIZE,
    IntrinsicsPrior,
    error_slopes,
    renormalised,
    renormalised_slopes,
)
from dgc_pose.estimation.least_squares import (
    CORRELATED,
    EFFICIENT,
    block_sums,
    jackknife,
    loss_terms,
    loss_width,
)
from dgc_pose.estimation.problem import DISTINCT_DEG, Hypothesis, TwoViewProblem
from dgc_pose.estimation.robust_fit import CAMERA, FOCAL, run_seeds
from dgc_pose.geometry.epipolar import depths, essential_from_pose, sampson_distance, skew
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.parallel import in_threads

_SUPPORTING_SHARE = 0.6  # inliers of the location over those of the pair's best hypothesis
_MIN_ITERATIONS = 100  # of a RANSAC run
_SAMPLED = 300  # matches of a pair that RANSAC draws from
_SCORED = 100  # matches of a pair for the comparison of starts
_FITTED = 400  # inliers of a pair in a fit; the errors of neighbours are correlated
_MIN_INLIERS = 8  # of a pair
_MAX_STARTS = 3  # number of starts that are fitted
_STEPS, _CONVERGED = 12, 1e-6
_MIN_KEPT = 0.95  # least score of a fit, over that of its start


@dataclass(frozen=True, eq=False)
class WorldPose:
    """The pose of the photograph, and the change of its camera from that of the problems."""

    R: np.ndarray  # (3, 3) cam_from_world
    centre: np.ndarray  # (3,) world
    parameters: np.ndarray  # (SIZE,) of the camera, see `intrinsics_prior`


@dataclass(frozen=True, eq=False)
class PairCorrespondences:
    """The matches of a reference (image 1), a database image, with the photograph (image 2)."""

    R: np.ndarray  # (3, 3) of the reference, cam_from_world
    centre: np.ndarray  # (3,) of the reference, world
    problem: TwoViewProblem  # normalised by both cameras
    hypotheses: Sequence[Hypothesis]  # of the pair

    @property
    def threshold(self) -> float:
        """Largest error of an inlier, in the unit of the problem."""
        return self.problem.threshold

    @property
    def seen(self) -> np.ndarray:
        """Points (N, 2) in the photograph, normalised."""
        return self.problem.points2

    def __len__(self) -> int:
        return len(self.problem)

    def subset(self, chosen: np.ndarray) -> PairCorrespondences:
        """Select matches."""
        return replace(self, problem=self.problem.subset(chosen))

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Sampson errors (N,), in the unit of the problem, and whether the points are in front of
        both cameras (N,)."""
        moved, (R, t) = self.moved(pose), self.pair_pose(pose)
        error = sampson_distance(moved.points1, moved.points2, essential_from_pose(R, t))
        depth1, depth2 = depths(moved.points1, moved.points2, R, t)
        error = error * math.exp(pose.parameters[0] / 2)
        return np.nan_to_num(error, nan=np.inf), (depth1 > 0) & (depth2 > 0)

    def slopes(self, pose: WorldPose, prior: IntrinsicsPrior) -> tuple[np.ndarray, np.ndarray]:
        """Signed errors (N,) and their Jacobian (N, 6 + M) by a rotation vector w (R becomes
        exp([w]x) R), the centre, and the basis of `prior`."""
        R, t = self.pair_pose(pose)
        parameters = np.concatenate([np.zeros(SIZE), pose.parameters])
        error, slopes, tangent = error_slopes(self.problem, R, t, prior, parameters)
        length = max(float(np.linalg.norm(self.centre - pose.centre)), 1e-12)
        # t rotates with R, moves with the centre, and changes only across its own direction.
        by_t = slopes[:, 3:5] @ tangent.T
        by_rotation = slopes[:, :3] - by_t @ skew(t)
        by_centre = -by_t @ pose.R / length
        return error, np.hstack([by_rotation, by_centre, slopes[:, 5:]])

    def pair_pose(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """R and unit t of the photograph relative to the reference; any t at distance 0."""
        t = pose.R @ (self.centre - pose.centre)
        length = np.linalg.norm(t)
        return pose.R @ self.R.T, t / length if length > 0 else np.array([0.0, 0.0, 1.0])

    def hypothesis(self, pose: WorldPose) -> Hypothesis:
        """The pose as a hypothesis of this pair."""
        return Hypothesis.of_pose(self.moved(pose), *self.pair_pose(pose))

    def moved(self, pose: WorldPose) -> TwoViewProblem:
        """The problem, normalised by the photograph's camera with the parameters of the pose."""
        problem = self.problem
        if not pose.parameters.any():
            return problem
        points2 = renormalised(problem.points2, problem.lenses[1], pose.parameters)
        return replace(problem, points2=points2)

    def supports(self, pose: WorldPose) -> bool:
        """Whether a hypothesis of the pair is within 10 degrees of the pose. The rotation suffices
        if `_SUPPORTING_SHARE` of the inliers remain, as with cameras near each other."""
        under = self.hypothesis(pose)
        if under.is_among(self.hypotheses):
            return True
        most = max(hypothesis.num_in_front for hypothesis in self.hypotheses)
        near = any(rotation_error_deg(under.R, h.R) < DISTINCT_DEG for h in self.hypotheses)
        return near and under.num_in_front >= _SUPPORTING_SHARE * most


@dataclass(frozen=True, eq=False)
class PointCorrespondences:
    """Points of the model that are visible in the photograph."""

    points: np.ndarray  # (N, 3) world
    seen: np.ndarray  # (N, 2) in the photograph, normalised by its camera
    lens: Distortion | None  # removed from `seen`
    threshold: float  # largest error of an inlier, normalised

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, chosen: np.ndarray) -> PointCorrespondences:
        """Select points."""
        return replace(self, points=self.points[chosen], seen=self.seen[chosen])

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """The larger of the reprojection errors along x and y (N,), and whether the points are in
        front of the camera (N,)."""
        offset, local = self._offset(pose)
        return np.nan_to_num(np.abs(offset).max(1), nan=np.inf), local[:, 2] > 0

    def slopes(self, pose: WorldPose, prior: IntrinsicsPrior) -> tuple[np.ndarray, np.ndarray]:
        """As `PairCorrespondences.slopes`, with 2 N errors: first along x, then along y."""
        offset, local = self._offset(pose)
        x, y, z = local.T[:, :, None]
        none = np.zeros_like(x)
        by_local = np.hstack([1 / z, none, -x / z**2, none, 1 / z, -y / z**2]).reshape(-1, 2, 3)
        by_rotation = np.cross(local[:, None], by_local)
        by_centre = -by_local @ pose.R
        undone = renormalised(self.seen, self.lens, pose.parameters)
        by_camera = -renormalised_slopes(self.seen, self.lens, pose.parameters, undone)
        growth = math.exp(pose.parameters[0])
        by_camera[:, :, 0] += offset / growth
        by_camera = by_camera @ prior.basis[SIZE:]
        slopes = growth * np.concatenate([by_rotation, by_centre, by_camera], axis=2)
        return offset.T.ravel(), slopes.transpose(1, 0, 2).reshape(2 * len(offset), -1)

    def _offset(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Reprojection errors (N, 2), in a unit independent of the focal length, and the points
        (N, 3) in the camera frame."""
        local = (self.points - pose.centre) @ pose.R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = local[:, :2] / local[:, 2:]
        offset = projected - renormalised(self.seen, self.lens, pose.parameters)
        return offset * math.exp(pose.parameters[0]), local


Correspondences = PairCorrespondences | PointCorrespondences


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
    even = [part.subset(_even(len(part), _SCORED)) for part in every]
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
        runs += in_threads(lambda seed: _of_pairs(samples, options, seed), run_seeds(options))
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


def _of_pairs(
    pairs: Sequence[PairCorrespondences], options: EstimationOptions, seed: int
) -> WorldPose | None:
    """The pose from one RANSAC run on the generalised relative pose (six-point solver), for pairs
    with at least five matches; None if it fails."""
    matches, references = [], []
    for number, pair in enumerate(pairs):
        match, reference = poselib.PairwiseMatches(), poselib.CameraPose()
        match.cam_id1, match.cam_id2 = number, 0
        match.x1, match.x2 = pair.problem.points1 * FOCAL, pair.problem.points2 * FOCAL
        reference.R, reference.t = pair.R, -pair.R @ pair.centre
        matches.append(match)
        references.append(reference)
    threshold = float(np.median([pair.threshold for pair in pairs])) * FOCAL
    settings = {
        "max_iterations": options.iterations,
        "min_iterations": min(options.iterations, _MIN_ITERATIONS),
        "max_epipolar_error": threshold,
        "seed": seed,
    }
    at_origin, cameras = poselib.CameraPose(), [CAMERA] * len(pairs)
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
    return pair.subset(chosen[_even(len(chosen), _SAMPLED)])


def _even(count: int, most: int) -> np.ndarray:
    """Indices of an even sample of at most `most` of `count` items."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)


def fitted(every: Sequence[Correspondences], pose: WorldPose, prior: IntrinsicsPrior) -> WorldPose:
    """Fit the pose and the parameters of the camera: least Cauchy loss of the inliers, by
    Gauss-Newton with weights from the loss and new inliers before each step. Return the start if
    the fit has a much worse score."""
    start = pose
    for _ in range(_STEPS):
        z = np.linalg.lstsq(prior.basis[SIZE:], pose.parameters, rcond=None)[0]
        information = np.diag([*np.zeros(6), *np.ones(len(prior))])
        gradient = np.concatenate([np.zeros(6), z])
        for part, width in _inliers(every, pose, _FITTED):
            error, slopes = part.slopes(pose, prior)
            weights = (EFFICIENT / width) ** 2 / CORRELATED / (1 + (error / width) ** 2)
            information += (slopes * weights[:, None]).T @ slopes
            gradient += (weights * error) @ slopes
        step = np.linalg.lstsq(information, -gradient, rcond=None)[0]
        parameters = pose.parameters + (prior.basis @ step[6:])[SIZE:]
        R = cv2.Rodrigues(step[:3])[0] @ pose.R
        pose = WorldPose(R, pose.centre + step[3:6], parameters)
        if abs(step @ gradient) < _CONVERGED:
            break
    return pose if score(every, pose) >= _MIN_KEPT * score(every, start) else start


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
            sample = chosen if most is None else chosen[_even(len(chosen), most)]
            yield part.subset(sample), width


def world_covariance(
    every: Sequence[Correspondences], pose: WorldPose, prior: IntrinsicsPrior
) -> np.ndarray | None:
    """Covariance (6 + M, 6 + M) of the rotation vector, radians, the centre, in the model's unit,
    and the basis of `prior`; None if the inliers do not determine them.

    By a jackknife over blocks of the photograph, each in all pairs at once, since errors within a
    block are correlated. With more than two sets of correspondences, it is averaged with a
    jackknife over whole sets, since each reference has errors of its own.
    """
    count = 6 + len(prior)
    information = np.diag([*np.zeros(6), *np.ones(len(prior))])
    terms, seen = [], []
    for part, width in _inliers(every, pose):
        error, slopes = part.slopes(pose, prior)
        terms.append((EFFICIENT / width) ** 2 / CORRELATED * loss_terms(error, slopes, width))
        seen.append(np.tile(part.seen, (len(error) // len(part), 1)))
    if not terms:
        return None
    groups = [block_sums(np.vstack(terms), np.vstack(seen), (0.0, 0.0))]
    if len(terms) > 2:
        groups.append(np.stack([of_pair.sum(0) for of_pair in terms]))
    total = information + groups[0][:, : count**2].sum(0).reshape(count, count)
    try:
        inverse = np.linalg.inv(total)
        covariance = np.mean([jackknife(total, sums) for sums in groups], axis=0)
    except np.linalg.LinAlgError:
        return None
    covariance += inverse @ information @ inverse
    return covariance if np.isfinite(covariance).all() else None
