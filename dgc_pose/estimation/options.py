"""What the estimator may be told, each choice with its default and unit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from dgc_pose.errors import InputError

EstimatorName = Literal["poselib", "pycolmap", "opencv"]


@dataclass(frozen=True)
class VerdictOptions:
    """The gates between a pose and no pose."""

    min_matches: int = 20  # distinct, finite matches
    min_inliers: int = 15
    min_inlier_ratio: float = 0.15  # of all matches
    # Decimal logarithm of the number of models that random matches would give so many inliers:
    # counts the freedom that RANSAC has in choosing a model.
    max_log10_false_alarms: float = -2.0
    # The inlier ratio must be so many times the one that the same model gets of the same points
    # paired wrongly. Neighbours among dense matches err together, which the count overrates.
    chance_factor: float = 3.0
    # Inliers of a dense map in one place are one piece of evidence: unrelated images have patches
    # that look alike, each of which gives dozens of matches. A place is 1/24 of the longer side
    # wide. Not asked of key points, which are found one by one.
    min_places: int = 20
    min_cheirality: float = 0.6  # share of inliers in front of both cameras
    # Matches that a rotation alone must explain to be the answer, over the inliers.
    rotation_share: float = 0.8
    # Inliers that a rotation alone must explain within the epipolar threshold itself to be the
    # answer whatever the parallax: dense matches err smoothly, which looks like a translation.
    still_share: float = 0.9
    # The motion that such a rotation leaves must spread so many times as wide as the error across
    # epipolar lines before it counts as evidence of a translation; more for few matches.
    min_parallax: float = 1.5
    # Rotation error to expect of a pose; with more, the inliers lie so that they hardly tell it.
    max_rotation_error_deg: float = 30.0
    planar_share: float = 0.85  # of inliers that one homography must explain to call them a plane
    small_angle_deg: float = 1.0  # median triangulation angle below which a warning is due


@dataclass(frozen=True)
class EstimationOptions:
    """How the pose is estimated. Raises InputError, naming the field, on a value out of range."""

    estimator: EstimatorName = "poselib"
    runs: int = 5  # each with a seed of its own; the model with most inliers is kept
    iterations: int = 1000  # of each run
    # Matches that a run draws its samples from, chosen anew for each; every run's model is scored,
    # and the best one refined, on all matches. RANSAC's time grows with the matches it scores.
    max_sampled: int = 3000
    threshold_px: float | None = None  # epipolar error of an inlier, original pixels
    threshold_factor: float = 2.0  # times the matches' own error_px, where threshold_px is None
    seed: int = 0
    refine: bool = True  # on the inliers of the best model
    verdict: VerdictOptions = field(default_factory=VerdictOptions)

    def __post_init__(self) -> None:
        if self.estimator not in get_args(EstimatorName):
            names = ", ".join(get_args(EstimatorName))
            raise InputError(f"estimator must be one of {names}, not '{self.estimator}'")
        for name in ("runs", "iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.max_sampled < 100:
            raise InputError(f"max_sampled must be at least 100, not {self.max_sampled}")
        for name in ("threshold_px", "threshold_factor"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"{name} must be positive and finite, not {value}")
        if self.seed < 0:
            raise InputError(f"seed must not be negative, not {self.seed}")
