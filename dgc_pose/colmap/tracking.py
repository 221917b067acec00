"""Key points that all pairs of an image share, found by tracking corners.

A reconstruction needs points seen in three or more views, but a dense matcher's matches lie at
different pixels in each pair. So each image gets corners near the matches of many of its pairs. In
each pair, the local affinity of the matches predicts where a corner lies in the other image, and
patch alignment refines this location to a fraction of a pixel. A corner and its locations form one
track. No key points are merged, so no match is moved.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from dgc_pose.batch.pairs import PairRow, epipolar_error_px
from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.sampling import nearest_to, spread
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.align import MIN_ZNCC, PATCH_RADIUS, locate, nearby_corners
from dgc_pose.matching.patches import LocalMatches, consistent

_AFFINITY_MATCHES = 12  # number of matches to fit a local affinity
# Farthest match that predicts a corner in the other image, as a share of the longer side.
_MAX_DISTANCE_TO_MATCH = 0.015
_MAX_UNSMOOTHED_SCALE = 1.5  # scale between images below which neither is smoothed
_MAX_SHIFT_PX = 3.0  # largest shift by alignment, pixels of the other image
_MAX_ERROR_PX = 1.0  # Sampson distance to the pose of the pair


@dataclass(frozen=True, eq=False)
class PairGeometry:
    """A pair whose images show the same scene."""

    row: PairRow  # of status ok, planar or rotation_only
    cameras: tuple[Camera, Camera]  # of the pose
    matches: Matches  # inliers of the pose


@dataclass(frozen=True, eq=False)
class SharedMatches:
    """Key points of images, and matches between them."""

    key_points: Mapping[str, np.ndarray]  # (N, 2) float64 by image, (0, 0) the first pixel's centre
    # (M, 2) uint32, indices of key points, by pair; a pair without matches is absent
    pairs: Mapping[tuple[str, str], np.ndarray]


def track_corners(
    pairs: Sequence[PairGeometry],
    load: Callable[[str], Image],
    per_image: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SharedMatches:
    """Key points and matches of all images of the pairs.

    load: returns an image by its name. It is called repeatedly for neighbouring images, and should
    cache the latest. per_image: most corners of an image, evenly spread.
    """
    by_names = {pair.row.names: pair for pair in pairs}
    pairs_of: defaultdict[str, list[PairGeometry]] = defaultdict(list)
    for pair in pairs:
        for name in pair.row.names:
            pairs_of[name].append(pair)
    key_points: defaultdict[str, list[np.ndarray]] = defaultdict(list)
    # By pair: indices of key points and scores.
    matches: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]]
    matches = {names: [] for names in by_names}

    def numbered(name: str, points: np.ndarray) -> np.ndarray:
        """Add key points; their indices (N,)."""
        first = sum(map(len, key_points[name]))
        key_points[name].append(points)
        return np.arange(first, first + len(points))

    for number, (name, its_pairs) in enumerate(pairs_of.items(), start=1):
        corners, tracks = _tracks_of(name, its_pairs, load, per_image)
        seen = np.isin(np.arange(len(corners)), np.concatenate([t[0] for t in tracks.values()]))
        key_point = np.full(len(corners), -1)
        key_point[seen] = numbered(name, corners[seen])
        indices = {other: numbered(other, points) for other, (_, points, _) in tracks.items()}
        for other, (corner, _, zncc) in tracks.items():
            ends = key_point[corner], indices[other]
            names = (name, other) if (name, other) in matches else (other, name)
            ends = ends if names[0] == name else ends[::-1]
            matches[names].append((np.column_stack(ends), zncc))
        # Two images that show one corner of this image are matched there too, if they are a pair.
        for names in permutations(tracks, 2):
            if names in by_names:
                (corner1, points1, zncc1), (corner2, points2, zncc2) = (tracks[n] for n in names)
                _, in1, in2 = np.intersect1d(
                    corner1, corner2, assume_unique=True, return_indices=True
                )
                pair = by_names[names]
                error = epipolar_error_px(pair.row, pair.cameras, points1[in1], points2[in2])
                in1 = in1[error <= _MAX_ERROR_PX]
                in2 = in2[error <= _MAX_ERROR_PX]
                ends = indices[names[0]][in1], indices[names[1]][in2]
                scores = np.minimum(zncc1[in1], zncc2[in2])
                matches[names].append((np.column_stack(ends), scores))
        progress(number, len(pairs_of))
    shared = {}
    for names, parts in matches.items():
        index, scores = map(np.concatenate, zip(*parts, strict=True))
        if len(index):
            shared[names] = one_to_one(index.astype(np.uint32), scores)
    return SharedMatches({k: np.concatenate(v) for k, v in key_points.items()}, shared)


def one_to_one(index: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """The best scored of matches (M, 2), in their order, so that no key point occurs twice."""
    best = np.ones(len(index), dtype=bool)
    order = np.argsort(-scores, kind="stable")
    for side in (0, 1):
        order = order[best[order]]
        _, first = np.unique(index[order, side], return_index=True)
        best &= np.isin(np.arange(len(index)), order[first])
    return index[best]


def _tracks_of(
    name: str, pairs: Sequence[PairGeometry], load: Callable[[str], Image], per_image: int
) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """The corners (N, 2) of an image; and by name of each other image, which corners (M,) it shows,
    their points (M, 2) there, and the ZNCC (M,)."""
    image = load(name)
    grey = _grey(image)
    matches_of_pairs = []  # with the image `name` as image 2
    for pair in pairs:
        raw = pair.matches if name == pair.row.name2 else pair.matches.swapped()
        matches_of_pairs.append(consistent(raw, _AFFINITY_MATCHES))
    corners = _choose(grey, matches_of_pairs, per_image)
    corners = corners[~image.is_masked(corners)]
    tracks = {}
    for pair, matches in zip(pairs, matches_of_pairs, strict=True):
        is_first = pair.row.name1 == name
        other = pair.row.name2 if is_first else pair.row.name1
        corner, points, zncc, scale = _transferred(image, load(other), matches, corners)
        ends = (corners[corner], points) if is_first else (points, corners[corner])
        tolerance = _MAX_ERROR_PX * max(1.0, scale)
        good = epipolar_error_px(pair.row, pair.cameras, *ends) <= tolerance
        tracks[other] = corner[good], points[good], zncc[good]
    return corners, tracks


def _transferred(
    image2: Image, image1: Image, matches: LocalMatches, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Locate corners (N, 2) of image 2 in image 1: indices (M,) of the corners with a match nearby
    and patches that can be aligned, their points (M, 2) and ZNCC (M,), and the scale of image 1
    over image 2. matches: consistent matches of both images."""
    distance, nearest = nearest_to(corners, matches.points2)
    index = np.flatnonzero(distance <= _MAX_DISTANCE_TO_MATCH * max(image2.size))
    if len(index) == 0:
        return index, np.zeros((0, 2)), np.zeros(0), 1.0
    near = matches.subset(nearest[index])
    begin = near.points1 + np.einsum("nij,nj->ni", near.affinity, corners[index] - near.points2)
    scale = float(np.median(np.sqrt(np.linalg.det(near.affinity))))
    aligned = locate(
        _smoothed(_grey(image1), scale),
        _smoothed(_grey(image2), 1 / scale),
        LocalMatches(begin, corners[index], near.affinity, index),
        radius=PATCH_RADIUS,
        max_shift=_MAX_SHIFT_PX * max(1.0, scale),
    )
    good = aligned.converged & (aligned.zncc >= MIN_ZNCC) & ~image1.is_masked(aligned.points1)
    return index[good], aligned.points1[good], aligned.zncc[good], scale


def points_in(
    image: Image, reference: Image, matches: Matches, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) of those corners (N, 2) of a reference that an image shows, and points (M, 2).

    matches: points1 in the reference, points2 in the image.
    """
    local = consistent(matches.swapped(), _AFFINITY_MATCHES)
    return _transferred(reference, image, local, corners)[:2]


def _choose(grey: np.ndarray, matches_of_pairs: Sequence[LocalMatches], most: int) -> np.ndarray:
    """At most `most` corners (N, 2), evenly spread: in each block, the corner near matches of most
    pairs; of several, the strongest."""
    parts = []
    for matches in matches_of_pairs:
        corners, strengths = nearby_corners(grey, matches.points2)
        unique, first = np.unique(corners, axis=0, return_index=True)
        parts.append(np.column_stack([unique, strengths[first]]))
    rows = np.concatenate(parts)
    if len(rows) == 0:
        return np.zeros((0, 2))
    _, first, corner = np.unique(rows[:, :2], axis=0, return_index=True, return_inverse=True)
    corner = np.argsort(np.argsort(first))[corner.ravel()]  # numbered by first occurrence
    support = np.bincount(corner)
    strength = np.zeros(len(first))
    strength[corner] = rows[:, 2]
    points = rows[np.sort(first), :2]
    rank = np.argsort(np.argsort(strength)) / len(strength)  # below 1: support decides first
    return points[spread(points, support + rank, grey.shape[::-1], most)]


def _grey(image: Image) -> np.ndarray:
    return cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)


def _smoothed(grey: np.ndarray, scale: float) -> np.ndarray:
    """An image, blurred to the detail of one in which the scene is `scale` times smaller."""
    if scale < _MAX_UNSMOOTHED_SCALE:
        return grey
    blurred: np.ndarray = cv2.GaussianBlur(grey, (0, 0), 0.5 * float(np.sqrt(scale**2 - 1)))
    return blurred
