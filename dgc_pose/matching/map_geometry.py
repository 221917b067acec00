"""How two images lie to each other, as the dense map shows it: rotation, scale, and the parts that
match."""

import math

import numpy as np

from dgc_pose.geometry.pixels import rescale
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.matching.correspondence_map import CorrespondenceMap

_MATCHABLE = 0.5  # matchability
_LEAST_SHARE = 0.01  # of the cells that must be matchable to determine rotation and scale
_OUTER = 1.0  # percent of the points, on each side, that may lie outside a window
_WINDOW_MARGIN = 0.25  # on each side of a window, of its sides
_MOST_SHARE = 0.4  # of an image's area; a larger window is not worth cutting out


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


def rotation_between(points1: np.ndarray, points2: np.ndarray) -> float:
    """Degrees, -180 to 180, by which image 2 has to be rotated counter-clockwise (as by
    `numpy.rot90`) to have the orientation of image 1.

    From the similarity that best fits points (N, 2) of one image and the other; 0 without any.
    """
    if len(points1) == 0:
        return 0.0
    points1, points2 = points1 - np.median(points1, 0), points2 - np.median(points2, 0)
    # As complex numbers, points1 = a points2: |a| is the scale, its argument the angle from 2 to 1.
    a = (points1 @ (1, 1j) * (points2 @ (1, -1j))).sum()
    # y points down, so a counter-clockwise rotation is by a negative angle.
    return float(-np.angle(a, deg=True))


def matchable_points(correspondence_map: CorrespondenceMap) -> tuple[np.ndarray, np.ndarray]:
    """The matchable cells: (N, 2) float64 in image 1 and image 2; none if they are few."""
    matchable = correspondence_map.matchability >= _MATCHABLE
    if matchable.mean() < _LEAST_SHARE:
        matchable = np.zeros_like(matchable)
    points1, points2 = correspondence_map.map[matchable], correspondence_map.grid[matchable]
    return points1.astype(np.float64), points2.astype(np.float64)


def window_shown(
    points: np.ndarray, size: tuple[int, int]
) -> tuple[tuple[int, int], tuple[float, float]]:
    """The part of an image of `size` (width, height) that holds nearly all of its points (N, 2)
    and a margin: (width, height), and the pixel at its centre. The whole image if that is not much
    larger, or without points.
    """
    whole = size, ((size[0] - 1) / 2, (size[1] - 1) / 2)
    if len(points) == 0:
        return whole
    low, high = np.percentile(points, (_OUTER, 100 - _OUTER), axis=0)
    margin = _WINDOW_MARGIN * (high - low)
    # Whole pixels, so that a window is cut without resampling.
    first = np.floor(np.maximum(low - margin, 0)).astype(int)
    last = np.ceil(np.minimum(high + margin, np.subtract(size, 1))).astype(int)
    width, height = (int(side) for side in last - first + 1)
    if width * height > _MOST_SHARE * math.prod(size):
        return whole
    x, y = (float(middle) for middle in (first + last) / 2)
    return (width, height), (x, y)


def scale_between(correspondence_map: CorrespondenceMap) -> float:
    """Pixels of image 1 per pixel of image 2: the median over the matchable cells.

    From areas of the map over a thirtieth of the image, which its errors hardly change; clipped to
    1/10 to 10. If few cells are matchable, that of equal fields of view.
    """
    points1 = correspondence_map.map.astype(np.float64)
    points2 = correspondence_map.grid.astype(np.float64)
    matchable = correspondence_map.matchability >= _MATCHABLE
    step = max(1, len(matchable) // 30)
    corners = matchable[:-step, :-step] & matchable[step:, :-step] & matchable[:-step, step:]
    if corners.mean() < _LEAST_SHARE:
        areas = [math.prod(size) for size in (correspondence_map.size1, correspondence_map.size2)]
        return math.sqrt(areas[0] / areas[1])
    measured = []
    for points in (points1, points2):
        across = (points[:-step, step:] - points[:-step, :-step])[corners]
        down = (points[step:, :-step] - points[:-step, :-step])[corners]
        measured.append(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
    return float(np.sqrt(np.median(measured[0] / measured[1])).clip(0.1, 10.0))
