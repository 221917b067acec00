"""The result of a localization: a pose in the model, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.covariance import error_radius, error_radius_deg
from dgc_pose.estimation.result import plain
from dgc_pose.estimation.status import short_text
from dgc_pose.matches import Matches

# no_scale: R is known, and only the direction of the centre from a database image.
# bad_input: one of several images, or its K, is unusable.
LocationStatus = Literal["located", "no_scale", "nowhere", "bad_input"]


_RIGHT_DEG = 5.0  # largest error of R of a right location
_RIGHT_SHARE = 0.05  # largest error of its centre, over the extent


def small_errors_probability(covariance: np.ndarray, extent: float) -> float:
    """Probability that a location at the right place has small errors, by its covariance (6, 6).
    extent: of the model."""
    errors = error_radius_deg(covariance[:3, :3]), error_radius(covariance[3:6, 3:6])
    within = 1.0
    for error, limit in zip(errors, (_RIGHT_DEG, _RIGHT_SHARE * extent), strict=True):
        if error > 0:  # a Rayleigh distribution is below it in nine cases of ten
            within *= 1 - 0.1 ** min((limit / error) ** 2, 300)
    return within


@dataclass(frozen=True, eq=False)
class DatabaseImage:
    """An image of the model that was matched with the query."""

    name: str
    matches: Matches  # points1 in the database image, points2 in the query
    inliers: np.ndarray  # (N,) bool, the matches that agree with the location
    probability: float | None  # that the pose of the pair is right; None if unknown
    agrees: bool  # whether the pair supports the location
    # Model points visible in both images, (M,) int, and their pixels in the query, (M, 2)
    points: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    seen: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Location:
    """The pose of a query in a model's frame and unit.

    Attributes:
        status: "located"; "no_scale", with a rotation and a direction; "nowhere"; or "bad_input" if
            one of several images, or its K, is unusable.
        reason: Why the query is not located; empty if it is.
        database_images: The images of the model that were matched, in this order.
        R: Rotation (3, 3) of cam_from_world, x = R X + t; None if the status is "nowhere" or
            "bad_input".
        centre: Position (3,) of the camera, world, in the model's unit; None unless located.
        direction: With "no_scale", the unit direction (3,), world, from a database image to the
            query; else None.
        direction_from: Name of this database image; None unless "no_scale".
        covariance: Covariance (6, 6) of a rotation vector w, radians, in the camera frame (the true
            R is exp([w]x) R), and of the centre, world, in the model's unit. Scaled so that 90 % of
            right locations are within their expected errors. None unless located.
        probability: Probability that R is within 5 degrees and the centre within 5 % of the
            largest distance between two cameras of the model; 0 unless located, None if the
            probabilities of the pairs are unknown.
        camera: The query's camera. If the query is located and its K is not exact, fitted to the
            matches, with the standard deviations that are left.
        stated: The query's camera as stated or assumed before the matches; None unless located.
        warnings: Sentences for the user.
        seconds: Time of each step: "load", "describe", "match", "estimate".
    """

    status: LocationStatus
    reason: str
    database_images: tuple[DatabaseImage, ...]
    R: np.ndarray | None = None
    centre: np.ndarray | None = None
    direction: np.ndarray | None = None
    direction_from: str | None = None
    covariance: np.ndarray | None = None
    probability: float | None = 0.0
    camera: Camera | None = None
    stated: Camera | None = None
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        if self.R is None or self.centre is None:
            return f"Location: {self.status}: {self.reason}"
        return f"Location: R {short_text(self.R)}, centre {short_text(self.centre)}"

    @property
    def success(self) -> bool:
        """Whether R and the centre are known."""
        return self.status == "located"

    @property
    def t(self) -> np.ndarray | None:
        """Translation (3,) of cam_from_world, in the model's unit; None unless located."""
        return None if self.R is None or self.centre is None else -self.R @ self.centre

    @property
    def cam_from_world(self) -> np.ndarray | None:
        """[R | t] (3, 4); None unless located."""
        return None if self.R is None or self.t is None else np.column_stack([self.R, self.t])

    def with_covariance(self, covariance: np.ndarray, extent: float) -> Location:
        """The location with another covariance (6, 6), and the probability that is left by it.
        extent: of the model."""
        assert self.covariance is not None
        if self.probability is None:
            return replace(self, covariance=covariance)
        before = small_errors_probability(self.covariance, extent)
        right = min(self.probability / before, 1.0) if before else 0.0
        probability = right * small_errors_probability(covariance, extent)
        return replace(self, covariance=covariance, probability=probability)

    def with_pose(self, cam_from_world: np.ndarray, spread: np.ndarray) -> Location:
        """The location with another pose (3, 4) and, in place of the covariance C, spread C
        spread^T. spread: (6, 6)."""
        assert self.covariance is not None
        R = cam_from_world[:, :3]
        t = cam_from_world[:, 3]
        covariance = spread @ self.covariance @ spread.T
        return replace(self, R=R, centre=-R.T @ t, covariance=covariance)

    @property
    def rotation_error_90_deg(self) -> float | None:
        """90 % quantile of the error of a right R, degrees; None unless located."""
        return None if self.covariance is None else error_radius_deg(self.covariance[:3, :3])

    @property
    def position_error_90(self) -> float | None:
        """90 % quantile of the error of a right centre, model units; None unless located."""
        return None if self.covariance is None else error_radius(self.covariance[3:, 3:])

    def to_dict(self) -> dict[str, Any]:
        """Convert the location to JSON values, as by `dgc-pose locate --json`; None if unknown."""
        names = (
            *("status", "R", "t", "centre", "direction", "direction_from"),
            *("rotation_error_90_deg", "position_error_90", "covariance", "probability", "camera"),
        )
        return {
            **{name: plain(getattr(self, name)) for name in names},
            "references": [
                {
                    "name": image.name,
                    "agrees": image.agrees,
                    "num_matches": len(image.matches),
                    "num_inliers": int(image.inliers.sum()),
                    "probability": image.probability,
                }
                for image in self.database_images
            ],
            "warnings": ([] if self.success else [self.reason]) + list(self.warnings),
            "seconds": {step: round(value, 4) for step, value in self.seconds.items()},
        }
