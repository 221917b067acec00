"""The dense map as a guide: where in image 1 a place of image 2 lies, how image 2 is turned, and
how much larger things are in image 1."""

from __future__ import annotations

import numpy as np

from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.refinement.sampling import bilinear


def places_in_image1(correspondences: CorrespondenceMap, points2: np.ndarray) -> np.ndarray:
    """Where the map sends places (N, 2) of image 2: (N, 2) float64, pixels of image 1.

    Bilinear between the map's cells; beyond the outer ones their own value.
    """
    height, width = correspondences.matchability.shape
    cells = (points2 + 0.5) * np.divide((width, height), correspondences.size2) - 0.5
    planes = np.moveaxis(correspondences.map, -1, 0)
    return np.concatenate(
        [bilinear(np.ascontiguousarray(plane), cells[:, None]) for plane in planes], -1
    ).astype(np.float64)


def quarter_turns(correspondences: CorrespondenceMap, matchability: float = 0.5) -> int:
    """By how many times 90 degrees image 2 must be turned (numpy.rot90) to stand like image 1.

    From the similarity that fits the map best over the cells of at least that matchability; 0
    where fewer than one cell in a hundred has it.
    """
    sure = correspondences.matchability >= matchability
    if sure.mean() < 0.01:
        return 0
    there = correspondences.map[sure].astype(np.float64)
    here = correspondences.grid[sure].astype(np.float64)
    there, here = there - np.median(there, 0), here - np.median(here, 0)
    # Complex numbers: there = a here, |a| the scale and its argument the turn from 2 to 1.
    a = (there @ (1, 1j) * (here @ (1, -1j))).sum()
    # y points down, so rot90, which turns against the clock, turns by a negative angle.
    return int(np.rint(-np.angle(a) / (np.pi / 2))) % 4


def zoom_between(correspondences: CorrespondenceMap, matchability: float = 0.5) -> float:
    """Pixels of image 1 to one of image 2: the median over cells of at least that matchability.

    From the map's area over a thirtieth of the image, which its errors hardly change; between 1/5
    and 5, and 1 where fewer than one cell in a hundred has it.
    """
    place, grid = correspondences.map.astype(np.float64), correspondences.grid.astype(np.float64)
    sure = correspondences.matchability >= matchability
    step = max(1, len(sure) // 30)
    corners = sure[:-step, :-step] & sure[step:, :-step] & sure[:-step, step:]
    if corners.mean() < 0.01:
        return 1.0
    areas = []
    for values in (place, grid):
        across = (values[:-step, step:] - values[:-step, :-step])[corners]
        down = (values[step:, :-step] - values[:-step, :-step])[corners]
        areas.append(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
    return float(np.sqrt(np.median(areas[0] / areas[1])).clip(0.2, 5.0))


def turned_points(points: np.ndarray, size: tuple[int, int], turns: int) -> np.ndarray:
    """Places (N, 2) of an image of `size` (width, height), in the image turned by numpy.rot90."""
    width, height = size
    x, y = points.T
    if turns % 4 == 1:
        x, y = y, width - 1 - x
    elif turns % 4 == 2:
        x, y = width - 1 - x, height - 1 - y
    elif turns % 4 == 3:
        x, y = height - 1 - y, x
    return np.stack([x, y], -1)
