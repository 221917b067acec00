from __future__ import annotations

import numpy as np

from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.map_figure import MapPicture, draw_map_errors, plot_maps


def picture(title: str) -> MapPicture:
    rng = np.random.default_rng(0)
    image1 = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    y, x = np.mgrid[:20, :30].astype(np.float32)
    return MapPicture(title, image1, image1, np.stack([x, y], -1), np.zeros((20, 30)))


def test_a_row_a_pair_with_the_warped_source_third():
    figure = plot_maps([picture("first"), picture("second")])
    panels = [axes for axes in figure.axes if axes.images]
    titles = [axes.get_title(loc="left") for axes in panels]
    assert titles[::4] == ["first", "second"]
    assert titles[1:4] == titles[5:] == ["target", "source, warped", "error"]
    # The identity warps the source to itself.
    np.testing.assert_array_equal(panels[2].images[0].get_array(), panels[0].images[0].get_array())
    figure.canvas.draw()


def test_errors_are_bright_and_grey_where_nothing_is_known():
    axes = new_figure(3, 3).subplots()
    errors = np.array([[0.0, 10.0], [1e6, np.inf]])
    colours = draw_map_errors(axes, errors, limit=20)
    shown = axes.images[0].get_array().astype(int)
    sums = shown.sum(-1)
    assert sums[0, 0] < sums[0, 1] < sums[1, 0]
    np.testing.assert_allclose(shown[1, 0] / 255, colours.to_rgba(20.0)[:3], atol=0.01)
    assert len(set(shown[1, 1].tolist())) == 1
