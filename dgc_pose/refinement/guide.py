"""What the dense map shows: the points in image 1, and the rotation and scale between the images.
"""

from __future__ import annotations

import numpy as np

from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.pixels import rescale
from dgc_pose.sampling import bilinear

_LEAST_SHARE = 0.01  # of the cells that must be matchable to determine rotation and scale


def points_in_image1(correspondence_map: CorrespondenceMap, points2: np.ndarray) -> np.ndarray:
    """The map at points (N, 2) of image 2: (N, 2) float64, pixels of image 1.

    Bilinear between the map's cells, constant beyond the outer ones.
    """
    height, width = correspondence_map.matchability.shape
    cells = rescale(points2, correspondence_map.size2, (width, height))
    planes = np.moveaxis(correspondence_map.map, -1, 0)
    return np.concatenate(
        [bilinear(np.ascontiguousarray(plane), cells[:, None]) for plane in planes], -1
    ).astype(np.float64)


def rotation_between(correspondence_map: CorrespondenceMap, matchability: float = 0.5) -> int:
    """Quarter turns (of `numpy.rot90`) that bring image 2 nearest to the orientation of image 1.

    From the similarity that best fits the map over the cells of at least that matchability; 0 if
    they are less than one cell in a hundred.
    """
    matchable = correspondence_map.matchability >= matchability
    if matchable.mean() < _LEAST_SHARE:
        return 0
    points1 = correspondence_map.map[matchable].astype(np.float64)
    points2 = correspondence_map.grid[matchable].astype(np.float64)
    points1, points2 = points1 - np.median(points1, 0), points2 - np.median(points2, 0)
    # As complex numbers, points1 = a points2: |a| is the scale, its argument the angle from 2 to 1.
    a = (points1 @ (1, 1j) * (points2 @ (1, -1j))).sum()
    # y points down, so rot90, which rotates counter-clockwise, rotates by a negative angle.
    return int(np.rint(-np.angle(a) / (np.pi / 2))) % 4


def scale_between(correspondence_map: CorrespondenceMap, matchability: float = 0.5) -> float:
    """Pixels of image 1 per pixel of image 2: the median over cells of at least that matchability.

    From areas of the map over a thirtieth of the image, which its errors hardly change; clipped to
    1/5 to 5, and 1 if less than one cell in a hundred is matchable.
    """
    points1 = correspondence_map.map.astype(np.float64)
    points2 = correspondence_map.grid.astype(np.float64)
    matchable = correspondence_map.matchability >= matchability
    step = max(1, len(matchable) // 30)
    corners = matchable[:-step, :-step] & matchable[step:, :-step] & matchable[:-step, step:]
    if corners.mean() < _LEAST_SHARE:
        return 1.0
    areas = []
    for points in (points1, points2):
        across = (points[:-step, step:] - points[:-step, :-step])[corners]
        down = (points[step:, :-step] - points[:-step, :-step])[corners]
        areas.append(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
    return float(np.sqrt(np.median(areas[0] / areas[1])).clip(0.2, 5.0))


def rotate_points(points: np.ndarray, size: tuple[int, int], quarter_turns: int) -> np.ndarray:
    """Points (N, 2) of an image of `size` (width, height), in the image rotated by numpy.rot90."""
    width, height = size
    x, y = points.T
    if quarter_turns % 4 == 1:
        x, y = y, width - 1 - x
    elif quarter_turns % 4 == 2:
        x, y = width - 1 - x, height - 1 - y
    elif quarter_turns % 4 == 3:
        x, y = height - 1 - y, x
    return np.stack([x, y], -1)
