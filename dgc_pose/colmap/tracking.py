"""Shared key points by tracking: a corner of one image is located anew in each of its pairs.

For each image, corners are chosen that many of its pairs have matches at. In each pair the local
affinity of the matches says where a corner lies in the other image, and alignment of patches
locates it there to a fraction of a pixel. A corner and its locations are one track: nothing is
merged, so no match is moved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.shared import (
    Names,
    PairGeometry,
    SharedMatches,
    fits_pose,
    neighbours_of,
    one_to_one,
)
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.refinement.align import locate, nearby_corners, spread
from dgc_pose.refinement.consistency import LocalMatches, consistent
from dgc_pose.system.options import check_options, option

_NEIGHBOURS = 12  # matches that a local affinity is fitted to
_SIMILAR = 1.5  # scale between images up to which neither is smoothed


@dataclass(frozen=True)
class TrackOptions:
    """Raises InputError, naming the field, for a value out of range."""

    per_image: int = option(1000, min=1)  # corners of an image, evenly spread
    # Farthest match that tells where a corner lies in the other image, as a share of the longer
    # side.
    reach: float = option(0.015, above=0, max=1)
    max_shift_px: float = option(3.0, above=0)  # by alignment, pixels of the other image
    patch_radius: int = option(7, min=2)  # pixels
    min_zncc: float = option(0.8, above=0, max=1)  # of aligned patches
    max_error_px: float = option(1.0, above=0)  # Sampson distance to the pose of the pair

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, eq=False)
class Track:
    """Corners of one image, and where they were found in one other image."""

    name: str  # of the other image
    corner: np.ndarray  # (M,) int, which corners
    points: np.ndarray  # (M, 2) float64, pixels of the other image
    zncc: np.ndarray  # (M,) float64


def track_corners(
    pairs: Sequence[PairGeometry],
    cameras: Mapping[str, Camera],
    load: Callable[[str], Image],
    options: TrackOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SharedMatches:
    """Key points and matches of all images of the pairs.

    load: an image by its name; it is called for neighbouring images again and again, and should
    keep the latest ones.
    """
    options = options or TrackOptions()
    builder = _Builder(pairs, cameras, options.max_error_px)
    own = neighbours_of(pairs)
    for number, (name, its_pairs) in enumerate(own.items()):
        corners, tracks = _tracks_of(name, its_pairs, cameras, load, options)
        builder.add(name, corners, tracks)
        progress(number + 1, len(own))
    return builder.result()


def _tracks_of(
    name: str,
    pairs: Sequence[PairGeometry],
    cameras: Mapping[str, Camera],
    load: Callable[[str], Image],
    options: TrackOptions,
) -> tuple[np.ndarray, list[Track]]:
    """The corners (N, 2) of an image, and where each pair has them."""
    image = load(name)
    grey = _grey(image)
    local = [_towards(pair, name) for pair in pairs]
    corners = _choose(grey, image.size, local, options.per_image)
    tracks = []
    for pair, found in zip(pairs, local, strict=True):
        other = pair.row.name2 if pair.row.name1 == name else pair.row.name1
        start = _predicted(corners, found, options.reach * max(image.size))
        if len(start.index) == 0:
            continue
        theirs = _grey(load(other))
        scale = float(np.median(np.sqrt(np.linalg.det(start.affinity))))
        aligned = locate(
            _smoothed(theirs, scale),
            _smoothed(grey, 1 / scale),
            start,
            radius=options.patch_radius,
            max_shift=options.max_shift_px * max(1.0, scale),
        )
        good = aligned.converged & (aligned.zncc >= options.min_zncc)
        ours, others = corners[aligned.index], aligned.points1
        first, second = (ours, others) if pair.row.name1 == name else (others, ours)
        tolerance = options.max_error_px * max(1.0, scale)
        good &= fits_pose(pair.row, cameras, first, second, tolerance)
        tracks.append(Track(other, aligned.index[good], others[good], aligned.zncc[good]))
    return corners, tracks


def _towards(pair: PairGeometry, name: str) -> LocalMatches:
    """The consistent matches of a pair, with the image `name` as image 2."""
    ours, theirs = pair.points1, pair.points2
    if pair.row.name2 == name:
        ours, theirs = theirs, ours
    error = pair.row.error_px or 1.0
    return consistent(Matches(theirs, ours, pair.scores, error), _NEIGHBOURS)


def _choose(
    grey: np.ndarray, size: tuple[int, int], local: Sequence[LocalMatches], most: int
) -> np.ndarray:
    """At most so many corners (N, 2), evenly spread: of each block the one near matches of the most
    pairs, then the strongest."""
    support: dict[tuple[float, float], int] = {}
    strengths: dict[tuple[float, float], float] = {}
    for found in local:
        corners, strength = nearby_corners(grey, found.points2)
        unique, first = np.unique(corners, axis=0, return_index=True)
        for corner, value in zip(map(tuple, unique.tolist()), strength[first], strict=True):
            support[corner] = support.get(corner, 0) + 1
            strengths[corner] = float(value)
    if not support:
        return np.zeros((0, 2))
    points = np.array(list(support), dtype=np.float64)
    strength = np.array(list(strengths.values()))
    rank = np.argsort(np.argsort(strength)) / len(strength)  # below 1: support decides first
    chosen = spread(points, np.array(list(support.values())) + rank, size, most)
    return points[chosen]


def _predicted(corners: np.ndarray, found: LocalMatches, reach: float) -> LocalMatches:
    """Where corners of image 2 are expected in image 1, of those with a match within `reach`;
    `index` is that of the corners."""
    if len(found.index) == 0 or len(corners) == 0:
        return LocalMatches(corners[:0], corners[:0], np.zeros((0, 2, 2)), np.zeros(0, np.int64))
    distance, nearest = cKDTree(found.points2).query(corners)
    index = np.flatnonzero(distance <= reach)
    nearest = nearest[index]
    affinity = found.affinity[nearest]
    offset = corners[index] - found.points2[nearest]
    start = found.points1[nearest] + np.einsum("nij,nj->ni", affinity, offset)
    return LocalMatches(start, corners[index], affinity, index)


def _grey(image: Image) -> np.ndarray:
    return cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)


def _smoothed(grey: np.ndarray, scale: float) -> np.ndarray:
    """An image that shows things `scale` times larger, without what the smaller one cannot show."""
    if scale < _SIMILAR:
        return grey
    blurred: np.ndarray = cv2.GaussianBlur(grey, (0, 0), 0.5 * float(np.sqrt(scale**2 - 1)))
    return blurred


class _Builder:
    """Puts the tracks of all images together."""

    def __init__(
        self, pairs: Sequence[PairGeometry], cameras: Mapping[str, Camera], max_error_px: float
    ) -> None:
        self._rows = {pair.names: pair.row for pair in pairs}
        self._cameras = cameras
        self._max_error_px = max_error_px
        self._count: dict[str, int] = {}
        self._points: dict[str, list[np.ndarray]] = {}
        self._matches: dict[Names, list[np.ndarray]] = {pair.names: [] for pair in pairs}
        self._scores: dict[Names, list[np.ndarray]] = {pair.names: [] for pair in pairs}

    def add(self, name: str, corners: np.ndarray, tracks: Sequence[Track]) -> None:
        """The corners of an image: key points of its own, and of each image they were found in."""
        seen = np.zeros(len(corners), dtype=bool)
        for track in tracks:
            seen[track.corner] = True
        own = np.full(len(corners), -1)
        own[seen] = self._add_points(name, corners[seen])
        placed = [(track, self._add_points(track.name, track.points)) for track in tracks]
        for track, index in placed:
            self._add_matches(name, own[track.corner], track.name, index, track.zncc)
        # Two images that share a corner of a third are matched there too, if they are a pair.
        for (one, index1), (other, index2) in combinations(placed, 2):
            self._add_common(one, index1, other, index2)

    def result(self) -> SharedMatches:
        points = {name: np.concatenate(parts) for name, parts in self._points.items()}
        pairs = {}
        for names, parts in self._matches.items():
            if sum(map(len, parts)):
                index, scores = np.concatenate(parts), np.concatenate(self._scores[names])
                pairs[names] = one_to_one(index.astype(np.uint32), scores)
        return SharedMatches(points, pairs)

    def _add_points(self, name: str, points: np.ndarray) -> np.ndarray:
        """The indices (N,) of new key points."""
        first = self._count.get(name, 0)
        self._count[name] = first + len(points)
        self._points.setdefault(name, []).append(points)
        return np.arange(first, first + len(points))

    def _add_matches(
        self, name1: str, index1: np.ndarray, name2: str, index2: np.ndarray, scores: np.ndarray
    ) -> None:
        if (name1, name2) not in self._matches:
            name1, index1, name2, index2 = name2, index2, name1, index1
        self._matches[name1, name2].append(np.column_stack([index1, index2]))
        self._scores[name1, name2].append(scores)

    def _add_common(self, one: Track, index1: np.ndarray, other: Track, index2: np.ndarray) -> None:
        names = (one.name, other.name)
        if names not in self._matches:
            if names[::-1] not in self._matches:
                return
            one, index1, other, index2 = other, index2, one, index1
        _, in1, in2 = np.intersect1d(
            one.corner, other.corner, assume_unique=True, return_indices=True
        )
        row = self._rows[one.name, other.name]
        points = one.points[in1], other.points[in2]
        fits = fits_pose(row, self._cameras, *points, self._max_error_px)
        in1, in2 = in1[fits], in2[fits]
        scores = np.minimum(one.zncc[in1], other.zncc[in2])
        self._add_matches(one.name, index1[in1], other.name, index2[in2], scores)
