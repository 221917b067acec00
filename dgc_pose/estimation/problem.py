"""The data that all stages of the estimation share: normalised matches and hypotheses of a pose."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.estimation.least_squares import loss_width
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.status import probability_text, short_text
from dgc_pose.geometry.epipolar import (
    depths,
    essential_from_pose,
    pose_candidates,
    sampson_distance,
)
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

_DEFAULTS = EstimationOptions()
THRESHOLD_FACTOR = 2.0  # the threshold over the matches' `error_px`
# Error of an unknown lens that two radial coefficients do not explain, over the longer side.
_LENS_ERROR = 0.001
_SLACK = 1.4  # of the image's sides, if its size is unknown and derived from the principal point
_MOST_OUTSIDE = 0.05  # share of the points that may lie outside
_LEAST_REACH = 0.5  # of the points along one side, over the side; 172 real pairs reach 0.63
_MIN_POINTS = 20  # fewer give no pose
MIN_MATCHES = 20  # distinct and finite matches that a verdict needs
DISTINCT_DEG = 10.0  # in R or t: poses nearer to each other count as one
_GRID = 24  # cells along the longer side of an image


@dataclass(frozen=True, eq=False)
class TwoViewProblem:
    """Matches of two cameras in normalised coordinates: x = K^-1 u, distortion undone."""

    matches: Matches  # all of them, pixels
    cameras: tuple[Camera, Camera]  # that normalise them
    options: EstimationOptions
    points1: np.ndarray  # (N, 2), normalised, of the matches used
    points2: np.ndarray  # (N, 2)
    index: np.ndarray  # (N,) int, the row of each in `matches`
    threshold: float  # Sampson distance below which a match is an inlier, in the points' unit
    cells: tuple[float, float]  # sides of a grid cell in images 1 and 2, in the points' unit
    warnings: tuple[str, ...] = ()  # what was dropped, and why

    @classmethod
    def of(
        cls,
        matches: Matches,
        camera1: Camera,
        camera2: Camera,
        options: EstimationOptions = _DEFAULTS,
    ) -> TwoViewProblem:
        """The problem of matches in pixels and their cameras.

        Drops and counts matches that are not finite, duplicates, and matches whose distortion
        cannot be undone. The threshold is the mean of the threshold in pixels of the originals,
        divided by the focal length of each camera.
        """
        rows = np.column_stack([matches.points1, matches.points2])
        finite = np.flatnonzero(np.isfinite(rows).all(1))
        _, first = np.unique(rows[finite], axis=0, return_index=True)
        index = finite[np.sort(first)]
        points1 = camera1.normalise(matches.points1[index])
        points2 = camera2.normalise(matches.points2[index])
        undone = np.isfinite(points1).all(1) & np.isfinite(points2).all(1)
        dropped = {
            "not finite": len(matches) - len(finite),
            "duplicates": len(finite) - len(index),
            "their distortion cannot be undone": int((~undone).sum()),
        }
        pixels = options.threshold_px or max(
            THRESHOLD_FACTOR * matches.error_px,
            *(_LENS_ERROR * max(c.size or (0,)) for c in (camera1, camera2) if c.lens_std),
            0.0,
        )
        return cls(
            *(matches, (camera1, camera2), options, points1, points2, index),
            threshold=pixels * normalised_pixel((camera1, camera2)),
            cells=(cell_side(camera1), cell_side(camera2)),
            warnings=tuple(
                f"{count} matches dropped: {why}" for why, count in dropped.items() if count
            ),
        ).subset(undone)

    def __len__(self) -> int:
        return len(self.points1)

    def subset(self, chosen: np.ndarray) -> TwoViewProblem:
        """The same problem with some of its matches. chosen: (N,) bool."""
        return replace(
            self,
            points1=self.points1[chosen],
            points2=self.points2[chosen],
            index=self.index[chosen],
        )

    def with_cameras(
        self, cameras: tuple[Camera, Camera], threshold_px: float | None = None
    ) -> TwoViewProblem:
        """The same matches normalised by other cameras; by default, with the threshold of these."""
        threshold_px = threshold_px or self.options.threshold_px
        return TwoViewProblem.of(
            self.matches, *cameras, replace(self.options, threshold_px=threshold_px)
        )

    @property
    def threshold_px(self) -> float:
        """The threshold in pixels of the originals."""
        return self.threshold / normalised_pixel(self.cameras)

    @property
    def confidence(self) -> np.ndarray:
        """Confidence (N,) of each match, 0 to 1."""
        return self.matches.confidence[self.index]

    @property
    def lenses(self) -> tuple[Distortion | None, Distortion | None]:
        """The distortions that are undone."""
        return self.cameras[0].distortion, self.cameras[1].distortion


def normalised_pixel(cameras: tuple[Camera, Camera]) -> float:
    """A pixel in the unit of normalised points: the mean over both cameras."""
    first, second = cameras
    return (1 / first.focal + 1 / second.focal) / 2


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose x2 = R x1 + t, its inliers among the N matches used, and values to compare it with
    other hypotheses.

    Attributes:
        R: Rotation (3, 3) from camera 1 to camera 2.
        t: Direction (3,) of the translation, unit length, in camera 2's axes.
        inliers: Which matches have a Sampson distance below the problem's threshold, (N,) bool.
        in_front: Which matches lie in front of both cameras, (N,) bool.
        likely: Whether it explains the matches about as well as the first.
        likelihood: Log-likelihood of all matches, divided by the root of the number of inliers of
            the first hypothesis.
        map_agreement: Share of the dense map that agrees, see `agreement`; None without a map.
        share: The probability that it is right if one hypothesis is; 0 if it is not likely.
        probability: Probability that R and t are both within 10 degrees of the truth; None before
            the verdict, and if no probability is fitted for such matches.
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
        R = short_text(self.R)
        t = short_text(self.t)
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
        """The hypothesis, of an essential matrix's four poses, with most inliers in front."""
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

    def agreement(self, map_problem: TwoViewProblem) -> float:
        """Share of a dense map's sample that agrees with the pose, weighted by the square of the
        matchability: a hardly matchable cell is little evidence."""
        distance = sampson_distance(map_problem.points1, map_problem.points2, self.E)
        weight = map_problem.confidence**2
        return float(weight @ (distance < map_problem.threshold)) / max(float(weight.sum()), 1e-9)

    def inverse(self) -> Hypothesis:
        """The hypothesis for camera 1 relative to camera 2."""
        return replace(self, R=self.R.T, t=-self.R.T @ self.t)

    def angle_to(self, R: np.ndarray, t: np.ndarray) -> float:
        """The larger of the angles to another pose's rotation and translation, degrees."""
        return max(rotation_error_deg(self.R, R), translation_error_deg(self.t, t))

    def is_among(self, others: Iterable[Hypothesis]) -> bool:
        """Whether this pose is within 10 degrees of one of the others."""
        return any(self.angle_to(other.R, other.t) <= DISTINCT_DEG for other in others)


def pose_loss_width(inliers: TwoViewProblem, R: np.ndarray, t: np.ndarray) -> float:
    """`loss_width` of the Sampson errors of a pose's inliers."""
    error = sampson_distance(inliers.points1, inliers.points2, essential_from_pose(R, t))
    return loss_width(error, inliers.threshold)


def cell_side(camera: Camera) -> float:
    """The side of a grid cell, normalised."""
    return float(max(image_size(camera))) / _GRID / camera.focal


def odd_extent(points: np.ndarray, camera: Camera, number: int) -> tuple[str, ...]:
    """A warning if points (N, 2), pixels, lie outside the image of camera 1 or 2, or only in a
    small part of it. Raises InputError if more than a few lie outside the camera's size."""
    points = points[np.isfinite(points).all(1)]
    size = np.array(image_size(camera))
    if len(points) < _MIN_POINTS or size.min() <= 1:
        return ()
    left, top = points.min(0)
    right, bottom = points.max(0)
    by, slack = ("", 1.0) if camera.size else (" (from cx and cy)", _SLACK)
    # Half a pixel beyond an edge may be another convention.
    outside = (np.abs(points - (size - 1) / 2) > (slack * size + 1) / 2).any(1)
    reach = f"points{number} span x {left:.0f} to {right:.0f}, y {top:.0f} to {bottom:.0f}"
    pixels = f"the {size[0]:.0f}x{size[1]:.0f} pixels of camera{number}{by}"
    if outside.mean() > _MOST_OUTSIDE:
        text = f"{reach}: {outside.sum()} of {len(points)} lie outside {pixels}"
        if camera.size:
            raise InputError(text)
        return (text,)
    if max((right, bottom) / size) < _LEAST_REACH:
        return (f"{reach}: less than half of both sides of {pixels}",)
    return ()
