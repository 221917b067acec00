"""SIFT key points, each compared with those alone that lie where the dense map says."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import cell_size
from dgc_pose.matching.sift import ERROR_PX, SiftMatcher
from dgc_pose.refinement.guide import places_in_image1

_MOST = 32  # key points compared in a window, the nearest


def match_sift(
    matcher: SiftMatcher,
    image1: Image,
    image2: Image,
    correspondences: CorrespondenceMap,
    *,
    window_cells: float,
    ratio: float,
) -> Matches:
    """Key points of image 2 with their best of the window around the place that the map names.

    window_cells: radius of the window in cells of the map. ratio: largest distance, of that to the
    second best of the window. The match must be the best one that its key point of image 1 gets.
    Confidence is 1 - distance ratio, and 1 for a point that is alone in its window.
    """
    points1, descriptors1 = matcher.key_points(image1)
    points2, descriptors2 = matcher.key_points(image2)
    if len(points1) == 0 or len(points2) == 0:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), ERROR_PX)
    radius = window_cells * cell_size(correspondences)
    most = min(_MOST, len(points1))
    _, near = cKDTree(points1).query(
        places_in_image1(correspondences, points2), k=most, distance_upper_bound=radius
    )
    near = near.reshape(len(points2), most)
    there = near < len(points1)  # cKDTree's index of "none left" is the number of points
    squares1, squares2 = (descriptors1**2).sum(1), (descriptors2**2).sum(1)
    rows, columns = np.nonzero(there)
    others = near[rows, columns]
    dots = np.einsum("mc,mc->m", descriptors2[rows], descriptors1[others])
    distance = np.full(near.shape, np.inf)
    square = squares2[rows] + squares1[others] - 2 * dots
    distance[rows, columns] = np.sqrt(np.maximum(square, 0))
    order = np.argsort(distance, 1)[:, :2]
    every = np.arange(len(points2))
    first = distance[every, order[:, 0]]
    second = distance[every, order[:, -1]] if most > 1 else np.full(len(points2), np.inf)
    best = near[every, order[:, 0]].clip(0, len(points1) - 1)
    closest = np.full(len(points1), np.inf)
    np.minimum.at(closest, best, first)
    kept = np.isfinite(first) & (first <= closest[best]) & (first <= ratio * second)
    confidence = 1 - first[kept] / np.maximum(second[kept], 1e-12)
    return Matches(points1[best[kept]], points2[kept], confidence, ERROR_PX)
