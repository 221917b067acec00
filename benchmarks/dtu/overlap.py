"""How much two calibrated views see in common, from the calibration alone."""

from __future__ import annotations

import numpy as np

from dgc_pose.benchmarks.dtu.calibration import DtuView, relative_pose

DEPTHS_MM = (425.0, 935.0)  # the depths between which DTU's objects stand in every view
GRID = (16, 12, 8)  # columns, rows and depths of the point set that fills a view


def overlap(view1: DtuView, view2: DtuView, size: tuple[int, int]) -> float:
    """The share of points seen by both views, 0 to 1, the same in either order.

    size: (width, height) of both images, pixels.

    Each view's frustum between the depths of DTU's objects is filled with points, and the share of
    all the points of both frusta that project into the other image is taken.
    """
    return (_share_seen(view1, view2, size) + _share_seen(view2, view1, size)) / 2


def _share_seen(view1: DtuView, view2: DtuView, size: tuple[int, int]) -> float:
    """The share of points in front of view 1 that project into the image of view 2."""
    width, height = size
    R, t = relative_pose(view1, view2)
    projected = (_frustum_points(view1, size) @ R.T + t) @ view2.K.T
    depth = projected[:, 2]
    # An edge of the image is half a pixel beyond the centre of its outermost pixels.
    x, y = projected[:, 0] + 0.5 * depth, projected[:, 1] + 0.5 * depth
    inside = (depth > 0) & (x >= 0) & (x <= width * depth) & (y >= 0) & (y <= height * depth)
    return float(inside.mean())


def _frustum_points(view: DtuView, size: tuple[int, int]) -> np.ndarray:
    """Points (N, 3) in the camera's axes that fill its image evenly, at every depth, mm."""
    columns, rows, depths = GRID
    x = (np.arange(columns) + 0.5) / columns * size[0] - 0.5
    y = (np.arange(rows) + 0.5) / rows * size[1] - 0.5
    z = np.linspace(*DEPTHS_MM, depths)
    pixels = np.stack([axis.ravel() for axis in (*np.meshgrid(x, y), np.ones((rows, columns)))])
    rays = np.linalg.solve(view.K, pixels)
    return (rays[:, None, :] * z[None, :, None]).reshape(3, -1).T
