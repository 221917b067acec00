from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.geometry.pixels import cell_centres, pixel_grid, rescale


def test_resizing_keeps_the_outer_edges() -> None:
    corners = np.array([[-0.5, -0.5], [639.5, 479.5]])
    found = rescale(corners, (640, 480), (240, 200))
    assert found == pytest.approx(np.array([[-0.5, -0.5], [239.5, 199.5]]))


def test_the_naive_rule_is_off_by_nearly_three_pixels() -> None:
    found = rescale(np.array([0.0, 0.0]), (240, 240), (1600, 1200))
    assert found == pytest.approx([0.5 * 1600 / 240 - 0.5, 0.5 * 1200 / 240 - 0.5])


def test_back_and_forth() -> None:
    points = np.random.default_rng(0).uniform(-5, 700, (20, 2))
    there = rescale(points, (640, 480), (333, 77))
    assert rescale(there, (333, 77), (640, 480)) == pytest.approx(points)


def test_grid() -> None:
    grid = pixel_grid((3, 2))
    assert grid.shape == (2, 3, 2) and grid[1, 2].tolist() == [2, 1]


def test_cell_centres_are_means_of_their_pixels() -> None:
    pixels = pixel_grid((12, 8))
    means = pixels.reshape(4, 2, 4, 3, 2).mean((1, 3))
    assert cell_centres((4, 4), (12, 8)) == pytest.approx(means)
