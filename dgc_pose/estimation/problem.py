"""The problem that all stages of the estimation share: normalised matches and a threshold."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.matches import Matches

_DEFAULTS = EstimationOptions()
THRESHOLD_FACTOR = 2.0  # the threshold over the matches' `error_px`
# Of what two radial coefficients leave of a lens that is not known, over the longer side.
_LENS_ERROR = 0.001
_SLACK = 1.4  # of the image's sides, where its size is that of a principal point in the middle
_MOST_OUTSIDE = 0.05  # share of the points
_LEAST_REACH = 0.5  # of the sides, along one of them; of 172 real pairs 0.63 and more
_MIN_POINTS = 20  # fewer are no pose
_GRID = 24  # cells along the longer side of an image


@dataclass(frozen=True, eq=False)
class TwoViewProblem:
    """Matches of two calibrated views in normalised coordinates: x = K^-1 u, distortion undone."""

    points1: np.ndarray  # (N, 2)
    points2: np.ndarray  # (N, 2)
    threshold: float  # Sampson distance below which a match is an inlier, in the points' unit
    cells: tuple[float, float]  # sides of a grid cell in images 1 and 2, in the points' unit
    seed: int  # of every random draw
    index: np.ndarray  # (N,) int, the row of each match in `Matches`
    confidence: np.ndarray  # (N,) of each match, 0 to 1
    key_points: bool = False  # whether the matches are independent detections
    warnings: tuple[str, ...] = ()  # what was dropped, and why
    lenses: tuple[Distortion | None, Distortion | None] = (None, None)  # whose distortion is undone
    surroundings: float | None = None  # of `Matches`

    @classmethod
    def of(
        cls,
        matches: Matches,
        camera1: Camera,
        camera2: Camera,
        options: EstimationOptions = _DEFAULTS,
    ) -> TwoViewProblem:
        """The problem of matches in pixels and their cameras.

        Matches that are not finite, duplicates, and matches whose distortion cannot be undone are
        dropped and counted. The threshold in pixels of the originals is divided by each camera's
        focal length; the mean of both counts.
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
            points1=points1,
            points2=points2,
            threshold=pixels * (1 / camera1.focal + 1 / camera2.focal) / 2,
            cells=(cell_side(camera1), cell_side(camera2)),
            seed=options.seed,
            index=index,
            confidence=matches.confidence[index],
            key_points=matches.key_points,
            lenses=(camera1.distortion, camera2.distortion),
            surroundings=matches.surroundings,
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
            confidence=self.confidence[chosen],
        )


def cell_side(camera: Camera) -> float:
    """The side of a grid cell, normalised."""
    return float(max(image_size(camera))) / _GRID / camera.focal


def image_size(camera: Camera) -> tuple[float, float]:
    """(width, height) of the image; without a size that whose middle the principal point is."""
    return camera.size or (2 * camera.K[0, 2] + 1, 2 * camera.K[1, 2] + 1)


def odd_extent(points: np.ndarray, camera: Camera, number: int) -> tuple[str, ...]:
    """A warning if points (N, 2), pixels, lie beyond the image of camera 1 or 2 or reach a small
    part of it alone. Raises InputError if more than a few lie outside the camera's size."""
    points = points[np.isfinite(points).all(1)]
    size = np.array(image_size(camera))
    if len(points) < _MIN_POINTS or size.min() <= 1:
        return ()
    (left, top), (right, bottom) = points.min(0), points.max(0)
    by, slack = ("", 1.0) if camera.size else (", by 2 cx + 1 and 2 cy + 1", _SLACK)
    # Half a pixel beyond an edge may be another convention.
    outside = (np.abs(points - (size - 1) / 2) > (slack * size + 1) / 2).any(1)
    reach = (
        f"points{number} have x from {left:.0f} to {right:.0f} and y from {top:.0f} to {bottom:.0f}"
    )
    pixels = f"the {size[0]:.0f} x {size[1]:.0f} pixels of camera{number}{by}"
    if outside.mean() > _MOST_OUTSIDE:
        text = f"{reach}: {outside.sum()} of {len(points)} lie outside {pixels}"
        if camera.size:
            raise InputError(text)
        return (text,)
    if max((right, bottom) / size) < _LEAST_REACH:
        return (f"{reach}: less than half of {pixels} along both sides",)
    return ()
