"""Correspondences of a photograph with a model: 2D-2D with a reference, and 2D-3D with points.

Both have errors for a pose of the photograph, and the derivatives of these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.hypothesis import DISTINCT_DEG, Hypothesis
from dgc_pose.estimation.intrinsics_prior import (
    SIZE,
    IntrinsicsPrior,
    error_slopes,
    renormalised,
    renormalised_slopes,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import depths, essential_from_pose, sampson_distance, skew
from dgc_pose.metrics import rotation_error_deg

_SUPPORTING_SHARE = 0.6  # of the inliers of a pair's pose, that those of the location are


@dataclass(frozen=True, eq=False)
class WorldPose:
    """The pose of the photograph, and how far its camera is from that of the problems."""

    R: np.ndarray  # (3, 3) cam_from_world
    centre: np.ndarray  # (3,) world
    parameters: np.ndarray  # (SIZE,) of the camera, see `intrinsics_prior`


@dataclass(frozen=True, eq=False)
class PairCorrespondences:
    """The matches of a reference with the photograph, which is image 2."""

    R: np.ndarray  # (3, 3) of the reference, cam_from_world
    centre: np.ndarray  # (3,) of the reference, world
    problem: TwoViewProblem  # normalised by both cameras
    hypotheses: Sequence[Hypothesis]  # of the pair

    @property
    def threshold(self) -> float:
        """Of an inlier, in the unit of the problem."""
        return self.problem.threshold

    @property
    def seen(self) -> np.ndarray:
        """(N, 2) in the photograph."""
        return self.problem.points2

    def __len__(self) -> int:
        return len(self.problem)

    def subset(self, chosen: np.ndarray) -> PairCorrespondences:
        """Some of the matches."""
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
        """Signed errors (N,), and their derivatives (N, 6 + M) by a rotation vector w, R becoming
        exp([w]x) R; the centre; and the basis of `prior`."""
        R, t = self.pair_pose(pose)
        parameters = np.concatenate([np.zeros(SIZE), pose.parameters])
        error, slopes, tangent = error_slopes(self.problem, R, t, prior, parameters)
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
        """The problem as the photograph's camera with the parameters of the pose normalises it."""
        problem = self.problem
        if not pose.parameters.any():
            return problem
        points2 = renormalised(problem.points2, problem.lenses[1], pose.parameters)
        return replace(problem, points2=points2)

    def supports(self, pose: WorldPose) -> bool:
        """Whether a hypothesis of the pair is within 10 degrees of a pose; or its rotation is, and
        the matches fit both alike, as where the cameras are near each other."""
        under = self.hypothesis(pose)
        if under.is_among(self.hypotheses):
            return True
        most = max(hypothesis.num_in_front for hypothesis in self.hypotheses)
        near = any(rotation_error_deg(under.R, h.R) < DISTINCT_DEG for h in self.hypotheses)
        return near and under.num_in_front >= _SUPPORTING_SHARE * most


@dataclass(frozen=True, eq=False)
class PointCorrespondences:
    """Points of the model that the photograph shows."""

    points: np.ndarray  # (N, 3) world
    seen: np.ndarray  # (N, 2) in the photograph, normalised by its camera
    lens: Distortion | None  # that is undone
    threshold: float  # of an inlier, normalised

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, chosen: np.ndarray) -> PointCorrespondences:
        """Some of the points."""
        return replace(self, points=self.points[chosen], seen=self.seen[chosen])

    def errors(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """The larger reprojection error (N,) of both axes, and whether the points are in front."""
        offset, local = self._offset(pose)
        return np.nan_to_num(np.abs(offset).max(1), nan=np.inf), local[:, 2] > 0

    def slopes(self, pose: WorldPose, prior: IntrinsicsPrior) -> tuple[np.ndarray, np.ndarray]:
        """As of `PairCorrespondences`, (2 N,): the errors along x, then those along y."""
        offset, local = self._offset(pose)
        x, y, z = local.T[:, :, None]
        none = np.zeros_like(x)
        by_local = np.hstack([1 / z, none, -x / z**2, none, 1 / z, -y / z**2]).reshape(-1, 2, 3)
        by_rotation = np.cross(local[:, None], by_local)
        by_centre = -by_local @ pose.R
        by_camera = -renormalised_slopes(self.seen, self.lens, pose.parameters)
        growth = math.exp(pose.parameters[0])
        by_camera[:, :, 0] += offset / growth
        by_camera = by_camera @ prior.basis[SIZE:]
        slopes = growth * np.concatenate([by_rotation, by_centre, by_camera], axis=2)
        return offset.T.ravel(), slopes.transpose(1, 0, 2).reshape(2 * len(offset), -1)

    def _offset(self, pose: WorldPose) -> tuple[np.ndarray, np.ndarray]:
        """Reprojection errors (N, 2), in the same unit at all focal lengths, and the points (N, 3)
        in the camera's axes."""
        local = (self.points - pose.centre) @ pose.R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = local[:, :2] / local[:, 2:]
        offset = projected - renormalised(self.seen, self.lens, pose.parameters)
        return offset * math.exp(pose.parameters[0]), local
