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

# no_scale: R is known, and of the centre the direction from a database image alone.
LocationStatus = Literal["located", "no_scale", "nowhere"]


@dataclass(frozen=True, eq=False)
class DatabaseImage:
    """An image of the model that was matched with the query."""

    name: str
    matches: Matches  # points1 in the database image, points2 in the query
    inliers: np.ndarray  # (N,) bool, the matches that agree with the location
    probability: float | None  # that the pose of the pair is right; None: not known
    agrees: bool  # whether the location rests on it
    # Points of the model that both show, (M,) int, and where the query does, (M, 2) pixels
    points: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    seen: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Location:
    """The pose of a query in a model's frame and unit.

    Attributes:
        status: "located"; "no_scale", with a rotation and a direction; or "nowhere".
        reason: Why the query is not located; empty if it is.
        database_images: The images of the model that were matched, in this order.
        R: Rotation (3, 3) of cam_from_world, x = R X + t; None if it is nowhere.
        centre: Position (3,) of the camera, world, in the model's unit; None unless located.
        direction: With "no_scale" the unit direction (3,), world, from a database image to the
            query; else None.
        direction_from: The name of that database image.
        covariance: Covariance (6, 6) of a rotation vector w, radians, in the camera's axes, the
            true R being exp([w]x) R, and of the centre, world, in the model's unit. Scaled so that
            the expected errors of right locations hold nine times in ten. None unless located.
        probability: Probability that R is within 5 degrees and the centre within 5 % of the
            largest distance of two cameras of the model; 0 unless located, None if those of the
            pairs are not known.
        camera: The query's camera; if it is located, with the focal length that the matches
            determine, if it had a deviation.
        warnings: Sentences for people.
        seconds: Time by what was done: "load", "describe", "match", "estimate".
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

    def with_pose(self, cam_from_world: np.ndarray, spread: np.ndarray) -> Location:
        """The location with another pose (3, 4), and with the covariance spread C spread^T in place
        of C. spread: (6, 6)."""
        assert self.covariance is not None  # only of a location
        R, t = cam_from_world[:, :3], cam_from_world[:, 3]
        covariance = spread @ self.covariance @ spread.T
        return replace(self, R=R, centre=-R.T @ t, covariance=covariance)

    @property
    def rotation_error_90_deg(self) -> float | None:
        """The error of R, degrees, that nine in ten right ones stay below; None unless located."""
        return None if self.covariance is None else error_radius_deg(self.covariance[:3, :3])

    @property
    def position_error_90(self) -> float | None:
        """The error of the centre, in the model's unit, likewise."""
        return None if self.covariance is None else error_radius(self.covariance[3:, 3:])

    def to_dict(self) -> dict[str, Any]:
        """The location as values of JSON, as `dgc-pose locate --json` writes it; None of what is
        not known."""
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
