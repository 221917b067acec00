"""The figure of a reconstruction."""

from __future__ import annotations

import numpy as np
from multi_view import render_views

from dgc_pose.viz.reconstruction import plot_reconstruction


def test_cameras_and_points_from_above_and_from_the_front() -> None:
    """Each view has a dot for each camera, the points are drawn, and all cameras lie within."""
    poses = [np.column_stack([v.R, v.t]) for v in render_views(3)]
    points = np.random.default_rng(0).normal((0, 0, 4), 1, (500, 3))
    figure = plot_reconstruction(poses, points, np.full((500, 3), 128, np.uint8))
    assert len(figure.axes) == 2
    for axes in figure.axes:
        (cameras,) = (line for line in axes.lines if line.get_marker() == "o")
        places = np.asarray(cameras.get_xydata())
        assert len(places) == 3
        for low_high, values in ((axes.get_xlim(), places[:, 0]), (axes.get_ylim(), places[:, 1])):
            assert low_high[0] < values.min() <= values.max() < low_high[1]
        assert axes.collections[0].get_offsets().shape == (500, 2)


def test_without_points() -> None:
    poses = [np.column_stack([v.R, v.t]) for v in render_views(2)]
    figure = plot_reconstruction(poses, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    assert len(figure.axes) == 2
