"""What an estimate says: a pose, or plainly that there is none and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from dgc_pose.geometry.rotation import quaternion_wxyz

if TYPE_CHECKING:
    from dgc_pose.estimation.verdict import Evidence

Status = Literal[
    "ok",  # R and t
    "planar",  # R and t, but from a plane, which allows a second solution
    "rotation_only",  # R alone: the images do not tell t
    "too_few_matches",
    "no_model",  # the estimator found no essential matrix, or many: all points on one line
    "chance_inliers",  # no more inliers than unrelated images would give
    "behind_cameras",  # most points would lie behind a camera
]


@dataclass(frozen=True, eq=False)
class RelativePose:
    """The pose of camera 2 relative to camera 1, x2 = R x1 + t, with the translation up to scale.

    `success` means that both R and t are known. After "rotation_only" (also identical images) R is
    kept and t is None; after any other failure both are None: no pose is ever invented.
    """

    status: Status
    success: bool
    reason: str  # one sentence for a person
    R: np.ndarray | None  # (3, 3)
    t: np.ndarray | None  # (3,), unit length
    E: np.ndarray | None  # (3, 3) essential matrix [t]x R, of normalised points
    inliers: np.ndarray  # (N,) bool, over the matches as they were given
    num_matches: int  # matches used, without those dropped as not finite or duplicate
    num_inliers: int
    inlier_ratio: float  # of num_matches
    cheirality_ratio: float  # share of inliers in front of both cameras; NaN without a model
    median_triangulation_angle_deg: float  # over inliers; NaN without a model
    homography_ratio: float  # inliers of one homography over those of E; NaN without a model
    # None without a pose, and where the inliers do not tell it. The inliers count as right: this
    # knows nothing of a plane's second pose, of a wrong K or of a wrong verdict. (6, 6), rad^2, of
    # rank 5: a rotation vector w and a change d of t, in camera 2's axes; the true pose is
    # exp([w]x) R and t + d.
    covariance: np.ndarray | None = None
    rotation_error_90_deg: float | None = None  # nine times in ten the error of R is below
    translation_error_90_deg: float | None = None  # and the angle between t and the true direction
    evidence: Evidence | None = None  # what the verdict rests on; None without a model
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)  # by stage of the pipeline

    @property
    def cam2_from_cam1(self) -> np.ndarray | None:
        """[R | t] (3, 4), or None where there is no pose."""
        if self.R is None or self.t is None:
            return None
        return np.column_stack([self.R, self.t])

    @property
    def quaternion_wxyz(self) -> np.ndarray | None:
        """R as a unit quaternion (w, x, y, z), or None where R is not known."""
        return None if self.R is None else quaternion_wxyz(self.R)
