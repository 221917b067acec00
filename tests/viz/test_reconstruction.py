"""The figure of a reconstruction."""

import numpy as np
import pytest
from multi_view import render_views

from dgc_pose.viz.reconstruction import plot_reconstruction


@pytest.mark.parametrize("count", [0, 500])
def test_cameras_and_points_from_above_and_from_the_front(count: int) -> None:
    """Each view has a dot for each camera, the points are drawn, and all cameras lie within."""
    poses = [np.column_stack([v.R, v.t]) for v in render_views(3)]
    points = np.random.default_rng(0).normal((0, 0, 4), 1, (count, 3))
    figure = plot_reconstruction(poses, points, np.full((count, 3), 128, np.uint8))
    assert len(figure.axes) == 2
    figure.canvas.draw()
    edges = figure.bbox.extents
    for axes in figure.axes:
        (cameras,) = (line for line in axes.lines if line.get_marker() == "o")
        places = np.asarray(cameras.get_xydata())
        assert len(places) == 3
        low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
        assert (low < places).all() and (places < high).all()
        assert axes.collections[0].get_offsets().shape == (count, 2)
        left, low_edge, right, high_edge = axes.get_tightbbox().extents  # with title and labels
        assert left > edges[0] and low_edge > edges[1] and right < edges[2] and high_edge < edges[3]
