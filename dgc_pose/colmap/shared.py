"""Key points that all pairs of an image share, and the matches between them.

Matches of a dense matcher lie at fresh places in each pair. A reconstruction needs tracks: points
that are seen in three views and more, so the pairs of an image must share key points.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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

    def facts(self) -> dict[str, Any]:
        """The numbers of images with key points, key points, pairs and matches; and of tracks, of
        key points connected by matches, by their number of images."""
        return {
            "images": sum(len(points) > 0 for points in self.key_points.values()),
            "key_points": sum(map(len, self.key_points.values())),
            "pairs": len(self.pairs),
            "matches": sum(map(len, self.pairs.values())),
            "tracks_by_length": self._tracks_by_length(),
        }

    def _tracks_by_length(self) -> dict[int, int]:
        counts = [len(points) for points in self.key_points.values()]
        image = np.repeat(np.arange(len(counts)), counts)  # of each key point
        first = dict(zip(self.key_points, np.cumsum([0, *counts]).tolist(), strict=False))
        edges = [
            index.astype(np.int64) + (first[name1], first[name2])
            for (name1, name2), index in self.pairs.items()
        ]
        ends = np.concatenate([np.zeros((0, 2), np.int64), *edges])
        track = _connected(len(image), ends)
        images_of_tracks = np.unique(np.column_stack([track, image]), axis=0)
        lengths = np.bincount(images_of_tracks[:, 0])
        return dict(sorted(Counter(lengths[lengths > 1].tolist()).items()))


def _connected(count: int, ends: np.ndarray) -> np.ndarray:
    """A number (count,) of each node of a graph with edges (E, 2): the least node that a path leads
    to."""
    label = np.arange(count)
    while True:
        least = label.copy()
        least_of_edges = label[ends].min(1)
        np.minimum.at(least, label[ends[:, 0]], least_of_edges)  # of the nodes that stand for both
        np.minimum.at(least, label[ends[:, 1]], least_of_edges)
        least = least[least[label]]
        if np.array_equal(least, label):
            return label
        label = least


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
