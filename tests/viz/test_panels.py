import numpy as np
import pytest

from dgc_pose.matching.warp import SHOWN_SIDE
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import (
    draw_image,
    draw_matchability,
    draw_matches,
    draw_warp,
)


@pytest.fixture
def axes():
    return new_figure(6, 4).subplots()


def picture(width, height, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("size", [(40, 30), (2400, 600)])
def test_axes_are_in_pixels_of_the_image_however_much_it_is_shrunk(axes, size):
    draw_image(axes, picture(*size))
    width, height = size
    assert axes.get_xlim() == (-0.5, width - 0.5)
    assert axes.get_ylim() == (height - 0.5, -0.5)
    assert list(axes.images[0].get_extent()) == [-0.5, width - 0.5, height - 0.5, -0.5]
    assert max(axes.images[0].get_array().shape[:2]) <= max(SHOWN_SIDE, 40)


def test_matches_join_the_same_places_of_both_pictures(axes):
    # Image 2 has half the height, so it is drawn twice as large, beyond the gap.
    points1 = np.array([[-0.5, -0.5], [100.0, 50.0]])
    points2 = np.array([[-0.5, -0.5], [149.5, 99.5]])
    draw_matches(axes, picture(300, 200), picture(150, 100), points1, points2, np.array([0.0, 1.0]))
    left, right = (image.get_extent() for image in axes.images)
    assert left[1] < right[0]
    assert right[3] - right[2] == left[3] - left[2] == -200
    assert right[1] - right[0] == pytest.approx(300)
    first, last = axes.collections[0].get_segments()
    assert first[0] == pytest.approx(points1[0])
    assert first[1] == pytest.approx([right[0], right[3]])
    assert last[0] == pytest.approx(points1[1])
    assert last[1] == pytest.approx([right[1], right[2]])
    low, high = axes.collections[0].get_colors()
    assert not np.allclose(low, high)


def test_a_paler_warp_and_a_darker_image_where_less_matchable(axes):
    matchability = np.repeat([[1.0, 1.0, 0.0, 0.0]], 4, axis=0)
    black = np.zeros((20, 30, 3), np.uint8)
    draw_warp(axes, black, np.full((4, 4, 2), 10.0), matchability, (40, 40))
    warped = axes.images[0].get_array()
    assert warped[20, 2].max() == 0 and warped[20, 37].min() > 200
    draw_matchability(axes, np.full((30, 40, 3), 255, np.uint8), matchability)
    shown = axes.images[1].get_array()
    assert shown.shape == (30, 40, 3)
    assert shown[15, 37].sum() < 1 < shown[15, 2, :2].sum()
