"""What places a photograph: its matches with database images of known pose, and points of the
model that it shows; with their errors and derivatives by the pose in the world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.intrinsics_prior import (
    SIZE,
    IntrinsicsPrior,
    error_slopes,
    renormalised,
    renormalised_slopes,
)
from dgc_pose.estimation.problem import DISTINCT_DEG, Hypothesis, TwoViewProblem
from dgc_pose.geometry.epipolar import depths, essential_from_pose, sampson_distance, skew
from dgc_pose.metrics import rotation_error_deg

_SUPPORTING_SHARE = 0.6  # inliers of the location over those of the pair's best hypothesis


@dataclass(frozen=True, eq=False)
class WorldPose:
    """The pose of the photograph, and the change of its camera from that of the problems."""

    R: np.ndarray  # (3, 3) cam_from_world
    centre: np.ndarray  # (3,) world
    parameters: np.ndarray  # (SIZE,) of the camera, see `intrinsics_prior`
    skew: float = 0.0  # growth of x with y, of normalised points; a camera has none

    def moved(self, step: np.ndarray, prior: IntrinsicsPrior) -> WorldPose:
        """The pose after a step of a fit: (6 + M,), and with the skew (7 + M,)."""
        own = step[6 : 6 + len(prior)]
        return WorldPose(
            cv2.Rodrigues(step[:3])[0] @ self.R,
            self.centre + step[3:6],
            self.parameters + (prior.basis @ own)[SIZE:],
            self.skew + float(step[6 + len(prior) :].sum()),
        )


def pose_slopes(
    slopes: np.ndarray, tangent: np.ndarray, t: np.ndarray, R: np.ndarray, length: float
) -> np.ndarray:
    """The derivatives (N, 6) by the pose of camera 2 in the world, a rotation vector and the
    centre, from those of `error_slopes` by the pose of the pair. t: of the pair, for centres at a
    distance of `length`. R: (3, 3) cam_from_world of camera 2."""
    # t rotates with R, moves with the centre, and changes only across its own direction.
    by_t = slopes[:, 3:5] @ tangent.T
    return np.hstack([slopes[:, :3] - by_t @ skew(t), -by_t @ R / length])


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

    def widened(self, factor: float) -> PairCorrespondences:
        """With a larger threshold."""
        return replace(self, problem=replace(self.problem, threshold=factor * self.threshold))

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Sampson errors (N,), in the unit of the problem, and whether the points are in front of
        both cameras (N,)."""
        moved = self.moved(pose)
        R, t = self.pair_pose(pose)
        error = sampson_distance(moved.points1, moved.points2, essential_from_pose(R, t))
        depth1, depth2 = depths(moved.points1, moved.points2, R, t)
        error = error * math.exp(pose.parameters[0] / 2)
        return np.nan_to_num(error, nan=np.inf), (depth1 > 0) & (depth2 > 0)

    def slopes(self, pose: WorldPose, prior: IntrinsicsPrior) -> tuple[np.ndarray, np.ndarray]:
        """Signed errors (N,) and their Jacobian (N, 6 + M) by a rotation vector w (R becomes
        exp([w]x) R), the centre, and the basis of `prior`."""
        R, t = self.pair_pose(pose)
        parameters = np.concatenate([np.zeros(SIZE), pose.parameters])
        problem = replace(self.problem, points2=_unskewed(self.problem.points2, pose))
        error, slopes, tangent = error_slopes(problem, R, t, prior, parameters)
        length = max(float(np.linalg.norm(self.centre - pose.centre)), 1e-12)
        by_pose = pose_slopes(slopes, tangent, t, pose.R, length)
        return error, np.hstack([by_pose, slopes[:, 5:]])

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
        points2 = _unskewed(problem.points2, pose)
        if pose.parameters.any():
            points2 = renormalised(points2, problem.lenses[1], pose.parameters)
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

    def widened(self, factor: float) -> PointCorrespondences:
        """With a larger threshold."""
        return replace(self, threshold=factor * self.threshold)

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """The larger of the reprojection errors along x and y (N,), and whether the points are in
        front of the camera (N,)."""
        offset, local, _ = self._offset(pose)
        return np.nan_to_num(np.abs(offset).max(1), nan=np.inf), local[:, 2] > 0

    def slopes(self, pose: WorldPose, prior: IntrinsicsPrior) -> tuple[np.ndarray, np.ndarray]:
        """As `PairCorrespondences.slopes`, with 2 N errors: first along x, then along y."""
        offset, local, undone = self._offset(pose)
        x, y, z = local.T[:, :, None]
        none = np.zeros_like(x)
        by_local = np.hstack([1 / z, none, -x / z**2, none, 1 / z, -y / z**2]).reshape(-1, 2, 3)
        by_rotation = np.cross(local[:, None], by_local)
        by_centre = -by_local @ pose.R
        seen = _unskewed(self.seen, pose)
        by_camera = -renormalised_slopes(seen, self.lens, pose.parameters, undone)
        growth = math.exp(pose.parameters[0])
        by_camera[:, :, 0] += offset / growth
        by_camera = by_camera @ prior.basis[SIZE:]
        slopes = growth * np.concatenate([by_rotation, by_centre, by_camera], axis=2)
        return offset.T.ravel(), slopes.transpose(1, 0, 2).reshape(2 * len(offset), -1)

    def _offset(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reprojection errors (N, 2), in a unit independent of the focal length; the points (N, 3)
        in the camera frame; and those of the photograph (N, 2), normalised by its camera."""
        local = (self.points - pose.centre) @ pose.R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = local[:, :2] / local[:, 2:]
        undone = renormalised(_unskewed(self.seen, pose), self.lens, pose.parameters)
        return (projected - undone) * math.exp(pose.parameters[0]), local, undone


Correspondences = PairCorrespondences | PointCorrespondences


def _unskewed(seen: np.ndarray, pose: WorldPose) -> np.ndarray:
    """Normalised points (N, 2) without the skew of the pose."""
    if not pose.skew:
        return seen
    return seen - pose.skew * np.column_stack([seen[:, 1], np.zeros(len(seen))])
