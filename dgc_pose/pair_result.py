"""A pose with what it was computed from, and what follows from both: points in space, residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import RelativePose
from dgc_pose.geometry.epipolar import depths, homogeneous
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap
from dgc_pose.metrics import epipolar_residuals_px


@dataclass(frozen=True, eq=False)
class PairResult:
    """A pose with everything that it was computed from, by `solve_pair`.

    Attributes:
        image1: Image 1.
        image2: Image 2.
        prior1: Camera of image 1 before the estimation: of the K stated or of EXIF data.
        prior2: Camera of image 2, likewise.
        matches: The N matches that the pose was estimated from.
        correspondence_map: The dense map; None for a matcher that makes none.
        pose: The pose, or why there is none.
    """

    image1: Image
    image2: Image
    prior1: Camera
    prior2: Camera
    matches: Matches
    correspondence_map: CorrespondenceMap | None
    pose: RelativePose

    def __repr__(self) -> str:
        return f"PairResult: {self.image1}, {self.image2}\n{self.matches}\n{self.pose}"

    @property
    def camera1(self) -> Camera:
        """Camera of image 1 that the pose is of; without a pose, `prior1`."""
        return self.pose.camera1 or self.prior1

    @property
    def camera2(self) -> Camera:
        """Camera of image 2, likewise."""
        return self.pose.camera2 or self.prior2

    @property
    def points3d(self) -> np.ndarray:
        """The matches' points (N, 3) float64 in camera 1's frame (OpenCV axes), in metres if the
        length of t is known, else in units of the distance between the cameras; on the rays of
        camera 1 where the two rays come nearest.

        NaN where a match is no inlier or its point is not in front of both cameras, and without R
        and t.
        """
        points = np.full((len(self.matches), 3), np.nan)
        R, t, inliers = self.pose.R, self.pose.t, self.pose.inliers
        if R is None or t is None:
            return points
        x1 = self.camera1.normalise(self.matches.points1[inliers])
        x2 = self.camera2.normalise(self.matches.points2[inliers])
        depth1, depth2 = depths(x1, x2, R, t * (self.pose.length or 1.0))
        ahead = (depth1 > 0) & (depth2 > 0) & np.isfinite(depth1)
        points[inliers] = homogeneous(x1) * np.where(ahead, depth1, np.nan)[:, None]
        return points

    @property
    def colours(self) -> np.ndarray:
        """Colours (N, 3) uint8 RGB of image 1 at the matches, of the nearest pixels; black where
        the match is not finite."""
        points = self.matches.points1
        finite = np.isfinite(points).all(1)
        last = np.array(self.image1.size) - 1
        x, y = np.rint(np.clip(np.where(finite[:, None], points, 0), 0, last)).astype(np.intp).T
        return self.image1.pixels[y, x] * finite[:, None].astype(np.uint8)

    @property
    def residuals_px(self) -> np.ndarray:
        """Symmetric epipolar distances (N,) of the matches, in pixels without lens distortion: the
        mean of the distances of each point to the epipolar line of the other.

        NaN without R and t, and where the distortion cannot be undone.
        """
        if self.pose.E is None:
            return np.full(len(self.matches), np.nan)
        points = self.matches.points1, self.matches.points2
        return epipolar_residuals_px(*points, self.camera1, self.camera2, self.pose.E)
