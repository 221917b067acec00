"""A hypothesis of the pose, and the matches that agree with it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.estimation.least_squares import loss_width
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.status import probability_text, short_text
from dgc_pose.geometry.epipolar import (
    depths,
    essential_from_pose,
    pose_candidates,
    sampson_distance,
)
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

DISTINCT_DEG = 10.0  # in R or t: poses nearer to each other count as one


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose x2 = R x1 + t with its inliers among the N matches used, and what the choice among
    several rests on.

    Attributes:
        R: Rotation (3, 3) from camera 1 to camera 2.
        t: Direction (3,) of the translation, unit length, in camera 2's axes.
        inliers: Which matches have a Sampson distance below the problem's threshold, (N,) bool.
        in_front: Which matches lie in front of both cameras, (N,) bool.
        likely: Whether it explains the matches about as well as the first.
        likelihood: Logarithm of the likelihood of all matches, over the root of the number of
            inliers.
        map_agreement: Share of the dense map that agrees, by matchability; None without a map.
        share: The probability that it is right if one is; 0 if it is not likely.
        probability: Probability that R and t are both within 10 degrees of the truth; None if no
            model of it is fitted for such matches, and before the verdict.
    """

    R: np.ndarray
    t: np.ndarray
    inliers: np.ndarray
    in_front: np.ndarray
    likely: bool = True
    likelihood: float = math.nan
    map_agreement: float | None = None
    share: float = math.nan
    probability: float | None = None

    def __repr__(self) -> str:
        R, t = short_text(self.R), short_text(self.t)
        likely = probability_text(self.probability)
        return f"Hypothesis(R={R}, t={t}, {self.num_inliers} inliers, {likely})"

    @classmethod
    def of_pose(cls, problem: TwoViewProblem, R: np.ndarray, t: np.ndarray) -> Hypothesis:
        """The hypothesis of a pose."""
        distance = sampson_distance(problem.points1, problem.points2, essential_from_pose(R, t))
        depth1, depth2 = depths(problem.points1, problem.points2, R, t)
        return cls(R, t, distance < problem.threshold, (depth1 > 0) & (depth2 > 0))

    @classmethod
    def of_essential(cls, problem: TwoViewProblem, E: np.ndarray) -> Hypothesis:
        """The one with most inliers in front of the cameras of an essential matrix's four poses."""
        poses = [cls.of_pose(problem, R, t) for R, t in pose_candidates(E)]
        return max(poses, key=lambda pose: pose.num_in_front)

    @property
    def E(self) -> np.ndarray:
        """Essential matrix [t]x R, (3, 3)."""
        return essential_from_pose(self.R, self.t)

    @property
    def num_inliers(self) -> int:
        """Number of inliers."""
        return int(self.inliers.sum())

    @property
    def inliers_in_front(self) -> np.ndarray:
        """(N,) bool, inliers in front of both cameras."""
        return self.inliers & self.in_front

    @property
    def num_in_front(self) -> int:
        """Number of inliers in front of both cameras."""
        return int(self.inliers_in_front.sum())

    def inverse(self) -> Hypothesis:
        """The same of camera 1 relative to camera 2."""
        return replace(self, R=self.R.T, t=-self.R.T @ self.t)

    def angle_to(self, R: np.ndarray, t: np.ndarray) -> float:
        """The larger of the angles to another pose's rotation and translation, degrees."""
        return max(rotation_error_deg(self.R, R), translation_error_deg(self.t, t))

    def is_among(self, others: Iterable[Hypothesis]) -> bool:
        """Whether one of these is within 10 degrees."""
        return any(self.angle_to(other.R, other.t) <= DISTINCT_DEG for other in others)


def pose_loss_width(inliers: TwoViewProblem, R: np.ndarray, t: np.ndarray) -> float:
    """`loss_width` of the Sampson errors of a pose's inliers."""
    error = sampson_distance(inliers.points1, inliers.points2, essential_from_pose(R, t))
    return loss_width(error, inliers.threshold)
