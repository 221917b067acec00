"""A pose hypothesis and the matches that agree with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import essential_from_pose, pose_candidates, sampson_distance
from dgc_pose.geometry.triangulation import depths
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

_DEVIATION = 1.4826  # standard deviation of Gaussian noise, over the median of its magnitude
EFFICIENT = 2.385  # Cauchy loss of 95 % efficiency on Gaussian noise, in standard deviations
_MIN_SCALE = 0.02  # of the threshold: matches are not trusted to be more accurate than that


@dataclass(frozen=True, eq=False)
class Model:
    """A pose x2 = R x1 + t with its inliers among the N matches of a problem.

    Attributes:
        R: Rotation (3, 3).
        t: Translation (3,), unit length.
        inliers: Which matches have a Sampson distance below the problem's threshold, (N,) bool.
        in_front: Which matches lie in front of both cameras, (N,) bool.
    """

    R: np.ndarray
    t: np.ndarray
    inliers: np.ndarray
    in_front: np.ndarray

    @classmethod
    def of_pose(cls, problem: TwoViewProblem, R: np.ndarray, t: np.ndarray) -> Model:
        """The model of a pose."""
        distance = sampson_distance(problem.points1, problem.points2, essential_from_pose(R, t))
        depth1, depth2 = depths(problem.points1, problem.points2, R, t)
        return cls(R, t, distance < problem.threshold, (depth1 > 0) & (depth2 > 0))

    @classmethod
    def of_essential(cls, problem: TwoViewProblem, E: np.ndarray) -> Model:
        """Of an essential matrix's four poses the one with most inliers in front of the cameras."""
        models = [cls.of_pose(problem, R, t) for R, t in pose_candidates(E)]
        return max(models, key=lambda model: model.count_in_front)

    @property
    def E(self) -> np.ndarray:
        """Essential matrix [t]x R, (3, 3)."""
        return essential_from_pose(self.R, self.t)

    @property
    def count(self) -> int:
        """Number of inliers."""
        return int(self.inliers.sum())

    @property
    def inliers_in_front(self) -> np.ndarray:
        """(N,) bool, inliers in front of both cameras."""
        return self.inliers & self.in_front

    def angle_to(self, R: np.ndarray, t: np.ndarray) -> float:
        """The larger of the angles to another pose's rotation and translation, degrees."""
        return max(rotation_error_deg(self.R, R), translation_error_deg(self.t, t))

    @property
    def count_in_front(self) -> int:
        """Number of inliers in front of both cameras."""
        return int(self.inliers_in_front.sum())


def pose_error_scale(inliers: TwoViewProblem, R: np.ndarray, t: np.ndarray) -> float:
    """`error_scale` of the Sampson errors of a pose's inliers."""
    error = sampson_distance(inliers.points1, inliers.points2, essential_from_pose(R, t))
    return error_scale(error, inliers.threshold)


def error_scale(error: np.ndarray, threshold: float) -> float:
    """Scale of the Cauchy loss for inliers' errors (N,), in their unit.

    From the median error, as if the errors were Gaussian; at most the threshold.
    """
    scale = EFFICIENT * _DEVIATION * float(np.median(error))
    return min(max(scale, _MIN_SCALE * threshold), threshold)
