"""Key points that all pairs of an image share, and the matches between them.

Matches of a dense matcher lie at fresh places in each pair. A reconstruction needs tracks: points
that are seen in three views and more, so the pairs of an image must share key points.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dgc_pose.batch.rows import PairRow
from dgc_pose.cameras.camera import Camera

Names = tuple[str, str]


@dataclass(frozen=True, eq=False)
class PairGeometry:
    """A pair whose images show the same scene, with the matches that fit its pose."""

    row: PairRow  # of status ok, planar or rotation_only
    cameras: tuple[Camera, Camera]  # that the pose is of
    points1: np.ndarray  # (N, 2) float64, pixels of image 1
    points2: np.ndarray  # (N, 2) float64
    scores: np.ndarray  # (N,) float64, confidence in [0, 1]

    @property
    def names(self) -> Names:
        return self.row.names

    def towards(self, name: str) -> tuple[str, np.ndarray, np.ndarray]:
        """The name of the other image, the points in it, and those in the image `name`."""
        if name == self.row.name2:
            return self.row.name1, self.points1, self.points2
        return self.row.name2, self.points2, self.points1


@dataclass(frozen=True, eq=False)
class SharedMatches:
    """Key points of images, and matches between them."""

    key_points: Mapping[str, np.ndarray]  # (N, 2) float64 by image, (0, 0) the first pixel's centre
    # (M, 2) uint32, indices of key points, by pair; a pair that shares none is absent
    pairs: Mapping[Names, np.ndarray]


def one_to_one(index: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Matches among (M, 2) in which no key point occurs twice: the best scored ones, in their
    order."""
    best = np.ones(len(index), dtype=bool)
    order = np.argsort(-scores, kind="stable")
    for side in (0, 1):
        order = order[best[order]]
        _, first = np.unique(index[order, side], return_index=True)
        best &= np.isin(np.arange(len(index)), order[first])
    return index[best]
