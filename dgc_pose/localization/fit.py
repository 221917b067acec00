"""The pose of a photograph from its matches with several references of known poses.

Each pair has an epipolar geometry that the pose in the world determines. RANSAC on the generalised
relative pose, and the hypotheses of the single pairs, whose lines of sight meet in the centre, are
starts; the best of them are fitted to the matches of all pairs together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TypeVar

import cv2
import numpy as np
import poselib

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.camera_spread import (
    SIZE,
    CameraSpread,
    deviated,
    deviated_slopes,
    error_slopes,
)
from dgc_pose.estimation.covariance import block_sums
from dgc_pose.estimation.hypothesis import (
    ALIKE,
    DISTINCT_DEG,
    EFFICIENT,
    Hypothesis,
    error_scale,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import run_seeds
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance, skew
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.geometry.triangulation import depths
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.threads import in_threads

S = TypeVar("S", "Sight", "PointSight", "Sight | PointSight")
_SAMPLED = 300  # matches of a pair that RANSAC draws from
_SCORED = 100  # matches of a pair that starts are compared by
_FITTED = 400  # inliers of a pair that a pose is fitted to: neighbours err alike
_MIN_INLIERS = 8  # of a pair
_MAX_STARTS = 3  # that are fitted
_AGREEING_SHARE = 0.6  # of the inliers of a pair's pose, that those of the location are
_ALIKE_DEG = 15.0  # between the rotations of two pairs that may be of one pose
_STEPS, _CONVERGED = 12, 1e-6
_MIN_KEPT = 0.95  # of the score, or a fit is rejected
_RIDGE = 1e-9
_FOCAL = 1000.0  # of the camera by which PoseLib has pixels
_CAMERA = {"model": "SIMPLE_PINHOLE", "width": 2, "height": 2, "params": [_FOCAL, 0.0, 0.0]}


@dataclass(frozen=True, eq=False)
class Sight:
    """A reference and its matches with the photograph, which is image 2."""

    R: np.ndarray  # (3, 3) of the reference, cam_from_world
    centre: np.ndarray  # (3,) of the reference, world
    problem: TwoViewProblem  # normalised by both cameras
    hypotheses: Sequence[Hypothesis]  # of the pair

    @property
    def threshold(self) -> float:
        """Of an inlier, in the unit of the problem."""
        return self.problem.threshold

    @property
    def places(self) -> np.ndarray:
        """(N, 2) in the photograph."""
        return self.problem.points2

    def __len__(self) -> int:
        return len(self.problem)

    def subset(self, chosen: np.ndarray) -> Sight:
        """Some of the matches."""
        return replace(self, problem=self.problem.subset(chosen))

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Sampson errors (N,), in the unit of the problem, and whether the points are in front of
        both cameras (N,)."""
        moved, (R, t) = self.moved(pose), self.pair_pose(pose)
        error = sampson_distance(moved.points1, moved.points2, essential_from_pose(R, t))
        depth1, depth2 = depths(moved.points1, moved.points2, R, t)
        error = error * math.exp(pose.deviations[0] / 2)
        return np.nan_to_num(error, nan=np.inf), (depth1 > 0) & (depth2 > 0)

    def slopes(self, pose: WorldPose, spread: CameraSpread) -> tuple[np.ndarray, np.ndarray]:
        """Signed errors (N,), and their derivatives (N, 6 + M) by a rotation vector w, R becoming
        exp([w]x) R; the centre; and the basis of `spread`."""
        R, t = self.pair_pose(pose)
        deviations = np.concatenate([np.zeros(SIZE), pose.deviations])
        error, slopes, tangent = error_slopes(self.problem, R, t, spread, deviations)
        length = max(float(np.linalg.norm(self.centre - pose.centre)), 1e-12)
        # t turns with R, and moves with the centre; of a unit vector the part across it counts.
        by_t = slopes[:, 3:5] @ tangent.T
        by_rotation = slopes[:, :3] - by_t @ skew(t)
        by_centre = -by_t @ pose.R / length
        return error, np.hstack([by_rotation, by_centre, slopes[:, 5:]])

    def pair_pose(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """R and unit t of the photograph relative to the reference; any t where both coincide."""
        t = pose.R @ (self.centre - pose.centre)
        length = np.linalg.norm(t)
        return pose.R @ self.R.T, t / length if length > 0 else np.array([0.0, 0.0, 1.0])

    def hypothesis(self, pose: WorldPose) -> Hypothesis:
        """The pose as a hypothesis of this pair."""
        return Hypothesis.of_pose(self.moved(pose), *self.pair_pose(pose))

    def moved(self, pose: WorldPose) -> TwoViewProblem:
        """The problem as the photograph's camera with the deviations of the pose normalises it."""
        problem = self.problem
        if not pose.deviations.any():
            return problem
        points2 = deviated(problem.points2, problem.lenses[1], pose.deviations)
        return replace(problem, points2=points2)

    def agrees(self, pose: WorldPose) -> bool:
        """Whether a hypothesis of the pair has the rotation of a pose, and the matches fit both
        alike."""
        under = self.hypothesis(pose)
        most = max(hypothesis.num_in_front for hypothesis in self.hypotheses)
        near = any(rotation_error_deg(under.R, h.R) < DISTINCT_DEG for h in self.hypotheses)
        return near and under.num_in_front >= _AGREEING_SHARE * most


@dataclass(frozen=True, eq=False)
class PointSight:
    """Points of the model that the photograph shows."""

    points: np.ndarray  # (N, 3) world
    places: np.ndarray  # (N, 2) in the photograph, normalised by its camera
    lens: Distortion | None  # that is undone
    threshold: float  # of an inlier, normalised

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, chosen: np.ndarray) -> PointSight:
        """Some of the points."""
        return replace(self, points=self.points[chosen], places=self.places[chosen])

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """The larger reprojection error (N,) of both axes, and whether the points are in front."""
        offset, seen = self._offset(pose)
        return np.nan_to_num(np.abs(offset).max(1), nan=np.inf), seen[:, 2] > 0

    def slopes(self, pose: WorldPose, spread: CameraSpread) -> tuple[np.ndarray, np.ndarray]:
        """As of a `Sight`, (2 N,): the errors along x, then those along y."""
        offset, seen = self._offset(pose)
        x, y, z = seen.T[:, :, None]
        none = np.zeros_like(x)
        by_seen = np.hstack([1 / z, none, -x / z**2, none, 1 / z, -y / z**2]).reshape(-1, 2, 3)
        by_rotation = np.cross(seen[:, None], by_seen)
        by_centre = -by_seen @ pose.R
        undone = deviated(self.places, self.lens, pose.deviations)
        by_camera = -deviated_slopes(self.places, self.lens, pose.deviations, undone)
        slopes = np.concatenate([by_rotation, by_centre, by_camera @ spread.basis[SIZE:]], axis=2)
        return offset.T.ravel(), slopes.transpose(1, 0, 2).reshape(2 * len(offset), -1)

    def _offset(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Reprojection errors (N, 2), and the points (N, 3) in the camera's axes."""
        seen = (self.points - pose.centre) @ pose.R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = seen[:, :2] / seen[:, 2:]
        return projected - deviated(self.places, self.lens, pose.deviations), seen


@dataclass(frozen=True, eq=False)
class WorldPose:
    """The pose of the photograph, and how far its camera is from that of the problems."""

    R: np.ndarray  # (3, 3) cam_from_world
    centre: np.ndarray  # (3,) world
    deviations: np.ndarray  # (SIZE,) of the camera, see `camera_spread`


AnySight = Sight | PointSight
Part = tuple[AnySight, float]  # inliers, and the scale of their errors


def located(
    sights: Sequence[Sight],
    points: Sequence[PointSight],
    spread: CameraSpread,
    options: EstimationOptions,
    before: WorldPose | None = None,
) -> WorldPose | None:
    """The pose that most matches agree with, fitted to them; None without a start.

    spread: of the references' camera, which is exact, and of the photograph's. before: the pose
    without the last of the sights: if that agrees with it, it is the start.
    """
    every = [*sights, *points]
    if before is not None and sights[-1].agrees(before):
        return fitted(every, before, spread)
    even = [_thinned(sight, _SCORED) for sight in every]
    starts = [*_of_points(points, options), *_starts(sights, options)]
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


def _starts(sights: Sequence[Sight], options: EstimationOptions) -> list[WorldPose]:
    poses = [pose for pair in combinations(sights, 2) for pose in _of_two(*pair)]
    samples = [_explained(sight) for sight in sights]
    usable = [n for n, sample in enumerate(samples) if len(sample.problem)]
    if len(usable) < 2:
        return poses
    matches = []
    for n in usable:
        match, problem = poselib.PairwiseMatches(), samples[n].problem
        match.cam_id1, match.cam_id2 = n, 0
        match.x1, match.x2 = problem.points1 * _FOCAL, problem.points2 * _FOCAL
        matches.append(match)
    references, photograph = [_extrinsic(s.R, s.centre) for s in sights], [poselib.CameraPose()]
    cameras = [_CAMERA] * len(sights)
    threshold = _FOCAL * float(np.median([s.problem.threshold for s in sights]))

    def run(seed: int) -> WorldPose | None:
        ransac = {
            "max_iterations": options.iterations,
            "min_iterations": 100,
            "max_epipolar_error": threshold,
            "seed": seed,
        }
        loss = {"loss_type": "TRUNCATED", "loss_scale": threshold}
        pose, info = poselib.estimate_generalized_relative_pose(
            matches, references, cameras, photograph, [_CAMERA], ransac, loss
        )
        if info["num_inliers"] == 0 or not np.isfinite(pose.Rt).all():
            return None
        return WorldPose(pose.R, -pose.R.T @ pose.t, np.zeros(SIZE))

    runs = in_threads(run, run_seeds(options))
    return [*poses, *(pose for pose in runs if pose is not None)]


def _of_points(points: Sequence[PointSight], options: EstimationOptions) -> list[WorldPose]:
    """The pose that most points agree with, by PoseLib's RANSAC on three points."""
    if sum(map(len, points)) < _MIN_INLIERS:
        return []
    ransac = {"max_iterations": options.iterations, "seed": options.seed}
    ransac["max_reproj_error"] = _FOCAL * max(sight.threshold for sight in points)
    places = np.concatenate([sight.places for sight in points]) * _FOCAL
    world = np.concatenate([sight.points for sight in points])
    pose, info = poselib.estimate_absolute_pose(places, world, _CAMERA, ransac, {})
    if info["num_inliers"] < _MIN_INLIERS or not np.isfinite(pose.Rt).all():
        return []
    return [WorldPose(pose.R, -pose.R.T @ pose.t, np.zeros(SIZE))]


def _of_two(first: Sight, second: Sight) -> list[WorldPose]:
    """The poses whose centre is where the lines of sight of two pairs come nearest to each
    other."""
    poses = []
    for one, two in product(first.hypotheses, second.hypotheses):
        R = one.R @ first.R
        if rotation_angle_deg(two.R @ second.R @ R.T) > _ALIKE_DEG:
            continue
        rays = np.stack([-(h.R @ s.R).T @ h.t for h, s in ((one, first), (two, second))])
        cosine = float(rays[0] @ rays[1])
        if cosine**2 > 1 - 1e-8:
            continue
        matrix = np.array([[1, -cosine], [-cosine, 1]])
        between = second.centre - first.centre
        lengths = np.linalg.solve(matrix, [rays[0] @ between, -rays[1] @ between])
        if (lengths > 0).all():
            centre = (
                first.centre + lengths[0] * rays[0] + second.centre + lengths[1] * rays[1]
            ) / 2
            poses.append(WorldPose(R, centre, np.zeros(SIZE)))
    return poses


def _explained(sight: Sight) -> Sight:
    """The matches that a hypothesis of the pair explains, an even sample."""
    explained = np.zeros(len(sight.problem), dtype=bool)
    for hypothesis in sight.hypotheses:
        explained |= hypothesis.inliers_in_front
    return _thinned(sight.subset(explained), _SAMPLED)


def _thinned(sight: S, most: int) -> S:
    chosen = np.linspace(0, len(sight) - 1, min(most, len(sight))).astype(int)
    return sight.subset(chosen)


def _extrinsic(R: np.ndarray, centre: np.ndarray) -> poselib.CameraPose:
    pose = poselib.CameraPose()
    pose.R, pose.t = R, -R @ centre
    return pose


def fitted(sights: Sequence[AnySight], pose: WorldPose, spread: CameraSpread) -> WorldPose:
    """The pose of least Cauchy loss of the Sampson errors of the inliers in front of the cameras,
    and the deviations of the camera: Gauss-Newton, with weights from the loss, and inliers chosen
    anew before each step. The pose itself if the fit has a much worse score."""
    start = pose
    for _ in range(_STEPS):
        prior = np.diag([*np.zeros(6), *np.ones(len(spread))])
        information, gradient = prior, prior[:, 6:] @ _z(pose, spread)
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
        chosen = in_front & (error < sight.threshold)
        if chosen.sum() >= _MIN_INLIERS:
            part = sight.subset(chosen)
            scale = error_scale(error[chosen], sight.threshold)
            parts.append((part if most is None else _thinned(part, most), scale))
    return parts


def _linearised(
    part: Part, pose: WorldPose, spread: CameraSpread, *, curvature: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives (N, 6 + M) of the errors, their weights (N,), and the gradients (N, 6 + M) of the
    loss. curvature: weights by the loss's second derivative, and not those of a step."""
    sight, scale = part
    error, slopes = sight.slopes(pose, spread)
    squared = (error / scale) ** 2
    weights = (EFFICIENT / scale) ** 2 / ALIKE / (1 + squared)
    gradients = slopes * (weights * error)[:, None]
    if curvature:
        weights = weights * np.maximum(1 - squared, 0) / (1 + squared)
    return slopes, weights, gradients


def _z(pose: WorldPose, spread: CameraSpread) -> np.ndarray:
    """The deviations of the camera in the basis of the spread."""
    z: np.ndarray = np.linalg.lstsq(spread.basis[SIZE:], pose.deviations, rcond=None)[0]
    return z


def world_covariance(
    sights: Sequence[AnySight], pose: WorldPose, spread: CameraSpread
) -> np.ndarray | None:
    """Covariance (6 + M, 6 + M) of the rotation vector, radians, the centre, in the model's unit,
    and the basis of `spread`; None if the inliers do not determine them.

    By the delete-a-group jackknife, as `estimation.covariance` has it: over blocks of the
    photograph in each pair, and over whole pairs, as references have errors of their own.
    """
    count = 6 + len(spread)
    prior = np.diag([*np.zeros(6), *np.ones(len(spread))])
    of_blocks = []
    for part in _parts(sights, pose):
        slopes, weights, gradients = _linearised(part, pose, spread, curvature=True)
        information = (slopes * weights[:, None])[:, :, None] * slopes[:, None]
        terms = np.column_stack([information.reshape(-1, count**2), gradients])
        places = np.tile(part[0].places, (len(terms) // len(part[0]), 1))
        of_blocks.append(block_sums(terms, places, (0.0, 0.0)))
    if len(of_blocks) < 2:
        return None
    groups = [np.vstack(of_blocks), np.stack([sums.sum(0) for sums in of_blocks])]
    total = prior + groups[0][:, : count**2].sum(0).reshape(count, count)
    try:
        inverse = np.linalg.inv(total)
        covariance = np.mean([_jackknife(total, sums) for sums in groups], axis=0)
    except np.linalg.LinAlgError:
        return None
    covariance += inverse @ prior @ inverse
    return covariance if np.isfinite(covariance).all() else None


def _jackknife(total: np.ndarray, sums: np.ndarray) -> np.ndarray:
    count, groups = len(total), len(sums)
    left_out = sums[:, : count**2].reshape(-1, count, count)
    moves = np.linalg.solve((1 + _RIDGE) * total - left_out, sums[:, count**2 :, None])[:, :, 0]
    covariance: np.ndarray = (groups - 1) / groups * moves.T @ moves
    return covariance
