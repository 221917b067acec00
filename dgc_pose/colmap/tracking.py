"""Shared key points by tracking: a corner of one image is located anew in each of its pairs.

For each image, corners are chosen that many of its pairs have matches at. In each pair the local
affinity of the matches predicts where a corner lies in the other image, and alignment of patches
locates it there to a fraction of a pixel. A corner and its locations are one track: nothing is
merged, so no match is moved.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import cv2
import numpy as np

from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.colmap.shared import Names, PairGeometry, SharedMatches, one_to_one
from dgc_pose.geometry.neighbours import nearest_to
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.align import MIN_ZNCC, PATCH_RADIUS, locate, nearby_corners, spread
from dgc_pose.matching.consistency import LocalMatches, consistent

_AFFINITY_MATCHES = 12  # matches that a local affinity is fitted to
# Farthest match that predicts a corner in the other image, as a share of the longer side.
_MAX_DISTANCE_TO_MATCH = 0.015
_MAX_UNSMOOTHED_SCALE = 1.5  # scale between images up to which neither is smoothed
_MAX_SHIFT_PX = 3.0  # by alignment, pixels of the other image
_MAX_ERROR_PX = 1.0  # Sampson distance to the pose of the pair


@dataclass(frozen=True, eq=False)
class Transferred:
    """Corners of image 2 in image 1."""

    corner: np.ndarray  # (M,) int, which corners
    points: np.ndarray  # (M, 2) float64, pixels of image 1
    zncc: np.ndarray  # (M,) float64


def track_corners(
    pairs: Sequence[PairGeometry],
    load: Callable[[str], Image],
    per_image: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SharedMatches:
    """Key points and matches of all images of the pairs.

    load: an image by its name; it is called for neighbouring images again and again, and should
    cache the latest ones. per_image: most corners of an image, evenly spread.
    """
    by_names = {pair.names: pair for pair in pairs}
    pairs_of: defaultdict[str, list[PairGeometry]] = defaultdict(list)
    for pair in pairs:
        for name in pair.names:
            pairs_of[name].append(pair)
    key_points: defaultdict[str, list[np.ndarray]] = defaultdict(list)
    # By pair: indices of key points and scores.
    matches: dict[Names, list[tuple[np.ndarray, np.ndarray]]] = {names: [] for names in by_names}

    def numbered(name: str, points: np.ndarray) -> np.ndarray:
        """The indices (N,) of new key points."""
        first = sum(map(len, key_points[name]))
        key_points[name].append(points)
        return np.arange(first, first + len(points))

    for number, (name, its_pairs) in enumerate(pairs_of.items(), start=1):
        corners, tracks = _tracks_of(name, its_pairs, load, per_image)
        seen = np.isin(np.arange(len(corners)), np.concatenate([t.corner for t in tracks.values()]))
        key_point = np.full(len(corners), -1)
        key_point[seen] = numbered(name, corners[seen])
        indices = {other: numbered(other, track.points) for other, track in tracks.items()}
        for other, track in tracks.items():
            ends = key_point[track.corner], indices[other]
            names = (name, other) if (name, other) in matches else (other, name)
            ends = ends if names[0] == name else ends[::-1]
            matches[names].append((np.column_stack(ends), track.zncc))
        # Two images that share a corner of a third are matched there too, if they are a pair.
        for names in permutations(tracks, 2):
            if names in by_names:
                track1, track2 = (tracks[name] for name in names)
                _, in1, in2 = np.intersect1d(
                    track1.corner, track2.corner, assume_unique=True, return_indices=True
                )
                pair, points = by_names[names], (track1.points[in1], track2.points[in2])
                fits = epipolar_error_px(pair.row, pair.cameras, *points) <= _MAX_ERROR_PX
                in1, in2 = in1[fits], in2[fits]
                ends = indices[names[0]][in1], indices[names[1]][in2]
                scores = np.minimum(track1.zncc[in1], track2.zncc[in2])
                matches[names].append((np.column_stack(ends), scores))
        progress(number, len(pairs_of))
    shared = {}
    for names, parts in matches.items():
        index, scores = map(np.concatenate, zip(*parts, strict=True))
        if len(index):
            shared[names] = one_to_one(index.astype(np.uint32), scores)
    return SharedMatches({k: np.concatenate(v) for k, v in key_points.items()}, shared)


def _tracks_of(
    name: str, pairs: Sequence[PairGeometry], load: Callable[[str], Image], per_image: int
) -> tuple[np.ndarray, dict[str, Transferred]]:
    """The corners (N, 2) of an image, and where each other image of a pair has them."""
    image = load(name)
    grey = _grey(image)
    matches_of_pairs = []  # with the image `name` as image 2
    for pair in pairs:
        _, points1, points2 = pair.towards(name)
        raw = Matches(points1, points2, pair.scores, pair.row.error_px or 1.0)
        matches_of_pairs.append(consistent(raw, _AFFINITY_MATCHES))
    corners = _choose(grey, matches_of_pairs, per_image)
    corners = corners[~image.is_masked(corners)]
    tracks = {}
    for pair, matches in zip(pairs, matches_of_pairs, strict=True):
        other, *_ = pair.towards(name)
        moved, scale = transferred(image, load(other), matches, corners)
        points1, points2 = moved.points, corners[moved.corner]
        if pair.row.name1 == name:
            points1, points2 = points2, points1
        tolerance = _MAX_ERROR_PX * max(1.0, scale)
        good = epipolar_error_px(pair.row, pair.cameras, points1, points2) <= tolerance
        tracks[other] = Transferred(moved.corner[good], moved.points[good], moved.zncc[good])
    return corners, tracks


def transferred(
    image2: Image, image1: Image, matches: LocalMatches, corners: np.ndarray
) -> tuple[Transferred, float]:
    """Where corners (N, 2) of image 2 lie in image 1: of those that have a match near, and whose
    patches can be aligned; and the scale of image 1 over image 2. matches: consistent ones of both
    images."""
    start = _predicted(corners, matches, _MAX_DISTANCE_TO_MATCH * max(image2.size))
    if len(start.index) == 0:
        return Transferred(start.index, start.points1, np.zeros(0)), 1.0
    scale = float(np.median(np.sqrt(np.linalg.det(start.affinity))))
    aligned = locate(
        _smoothed(_grey(image1), scale),
        _smoothed(_grey(image2), 1 / scale),
        start,
        radius=PATCH_RADIUS,
        max_shift=_MAX_SHIFT_PX * max(1.0, scale),
    )
    good = aligned.converged & (aligned.zncc >= MIN_ZNCC) & ~image1.is_masked(aligned.points1)
    return Transferred(aligned.index[good], aligned.points1[good], aligned.zncc[good]), scale


def points_in(
    image: Image, reference: Image, matches: Matches, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which corners (N, 2) of a reference an image shows, (M,) int, and where, (M, 2).

    matches: points1 in the reference, points2 in the image.
    """
    turned = replace(matches, points1=matches.points2, points2=matches.points1)
    local = consistent(turned, _AFFINITY_MATCHES)
    moved, _ = transferred(reference, image, local, corners)
    return moved.corner, moved.points


def _choose(grey: np.ndarray, matches_of_pairs: Sequence[LocalMatches], most: int) -> np.ndarray:
    """At most so many corners (N, 2), evenly spread: of each block the one near matches of the most
    pairs, then the strongest."""
    parts = []
    for matches in matches_of_pairs:
        corners, strengths = nearby_corners(grey, matches.points2)
        unique, first = np.unique(corners, axis=0, return_index=True)
        parts.append(np.column_stack([unique, strengths[first]]))
    rows = np.concatenate(parts)
    if len(rows) == 0:
        return np.zeros((0, 2))
    _, first, corner = np.unique(rows[:, :2], axis=0, return_index=True, return_inverse=True)
    corner = np.argsort(np.argsort(first))[corner.ravel()]  # numbered as they come first
    support, strength = np.bincount(corner), np.zeros(len(first))
    strength[corner] = rows[:, 2]
    points = rows[np.sort(first), :2]
    rank = np.argsort(np.argsort(strength)) / len(strength)  # below 1: support decides first
    return points[spread(points, support + rank, grey.shape[::-1], most)]


def _predicted(corners: np.ndarray, matches: LocalMatches, reach: float) -> LocalMatches:
    """Where corners of image 2 are expected in image 1, of those with a match within `reach`;
    `index` is that of the corners."""
    distance, nearest = nearest_to(corners, matches.points2)
    index = np.flatnonzero(distance <= reach)
    near = matches.subset(nearest[index])
    start = near.points1 + np.einsum("nij,nj->ni", near.affinity, corners[index] - near.points2)
    return LocalMatches(start, corners[index], near.affinity, index)


def _grey(image: Image) -> np.ndarray:
    return cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)


def _smoothed(grey: np.ndarray, scale: float) -> np.ndarray:
    """An image that shows things `scale` times larger, without what the smaller one cannot show."""
    if scale < _MAX_UNSMOOTHED_SCALE:
        return grey
    blurred: np.ndarray = cv2.GaussianBlur(grey, (0, 0), 0.5 * float(np.sqrt(scale**2 - 1)))
    return blurred
