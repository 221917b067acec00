"""Which cells of two images may match under a hypothesis of the pose: those near each other's
epipolar lines."""

from __future__ import annotations

import math

import numpy as np

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.pixels import cell_centres
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures
from dgc_pose.system.parallel import slices

_CHUNK = 128  # coarse cells at a time, which stay in the processor's cache
_CELLS = 1.0  # Sampson distance of the centres of two cells, in cells, below which they may match


class EpipolarBand:
    """The cells of stride 16 of a source and a target, or their `children` of stride 8, row by row.

    source, target: features of the views of the images.
    """

    def __init__(
        self,
        views: TwoViews,
        source: tuple[NativeFeatures, View],
        target: tuple[NativeFeatures, View],
        *,
        children: bool,
    ) -> None:
        finer = 2 if children else 1
        self.points1, side1 = _normalised(*source, views.camera1, finer)
        self.points2, side2 = _normalised(*target, views.camera2, finer)
        self.E = views.E.astype(np.float32)
        self.limit = _CELLS * (side1 + side2) / 2  # Sampson distance, in the points' unit

    def all(self) -> np.ndarray:
        """(n, m) bool, for each cell of the target which of the source it may match."""
        every1, every2 = (np.arange(len(points))[None] for points in (self.points1, self.points2))
        parts = slices(every2.size, _CHUNK)
        return np.concatenate([self.among(every2[:, part], every1)[0] for part in parts])

    def among(self, cells2: np.ndarray, cells1: np.ndarray) -> np.ndarray:
        """(n, q, m) bool, which of the source's cells (n, m) each of the target's (n, q) may
        match."""
        lines1, lines2 = self.points2[cells2] @ self.E, self.points1 @ self.E.T
        distance = np.abs(lines1 @ self.points1[cells1].transpose(0, 2, 1))
        norms2 = (lines2[:, :2] ** 2).sum(1)[cells1]
        norms = (lines1[..., :2] ** 2).sum(2)[:, :, None] + norms2[:, None]
        return distance < self.limit * np.sqrt(norms)


def _normalised(
    features: NativeFeatures, view: View, camera: Camera, finer: int
) -> tuple[np.ndarray, float]:
    """Centres (n, 3) float32 of the cells, normalised by the camera of the whole image and
    homogeneous, and the side of one."""
    rows, columns = (finer * side for side in features.coarse.shape[:2])
    centres = cell_centres((columns, rows), features.size).reshape(-1, 2)
    points = homogeneous(camera.normalise(view.to_image(centres)))
    area = math.prod(features.size) / (rows * columns) / view.scale**2
    return points.astype(np.float32), math.sqrt(area) / camera.focal
