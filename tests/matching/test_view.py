"""Views: where points of an image go, and which pixels a view shows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matching.view import View

BLANK = Image(np.zeros((40, 50, 3), np.uint8))


def _ramp(width: int, height: int) -> Image:
    """An image whose colours say where they are: red is 2 x, green 2 y, blue full."""
    grid = pixel_grid((width, height))
    return Image(np.dstack([2 * grid, np.full((height, width), 255)]).astype(np.uint8))


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_quarter_turns_are_those_of_numpy(quarter_turns: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    view = View.whole(Image(image), 90.0 * quarter_turns)
    rotated = np.rot90(image, quarter_turns)
    assert view.size == (rotated.shape[1], rotated.shape[0])
    assert np.array_equal(view.pixels(), rotated)
    points = np.array([[0, 0], [4, 0], [2, 6], [3, 1]])
    x, y = view.to_view(points).round().astype(int).T
    assert np.array_equal(rotated[y, x], image[points[:, 1], points[:, 0]])


@given(st.floats(-720, 720), st.floats(0.1, 5), st.floats(-300, 300), st.integers(1, 500))
def test_points_return(angle: float, scale: float, x: float, side: int) -> None:
    view = View.window(BLANK, (side, 40), (x, 7.0), angle, scale)
    points = np.array([[0.0, 0.0], [120.0, -30.0]])
    for cells in (None, (30, 20)):
        returned = view.to_image(view.to_view(points, cells), cells)
        np.testing.assert_allclose(returned, points, atol=1e-6)
    np.testing.assert_allclose(view.to_view(np.array(view.centre)), (np.array(view.size) - 1) / 2)


@pytest.mark.parametrize("angle", [0.0, 33.0, 90.0])
@pytest.mark.parametrize("scale", [0.4, 1.7])
def test_a_view_shows_what_its_points_say(angle: float, scale: float) -> None:
    view = View.window(_ramp(110, 100), (60, 40), (50.0, 45.0), angle, scale)
    shown = view.pixels().astype(float)
    points = view.centres(view.size)
    inner = ((points > 4) & (points < (105, 95))).all(-1)
    assert inner.sum() > 0.9 * inner.size
    np.testing.assert_allclose(shown[inner][:, :2], 2 * points[inner], atol=3)


def test_outside_the_image_is_one_colour_and_known() -> None:
    view = View.whole(_ramp(64, 48), 45.0)
    shown, inside = view.pixels(), view.mask(view.size)
    assert 0.35 < inside.mean() < 0.55  # 64 x 48 of the square of side (64 + 48) / sqrt(2)
    assert (shown[inside][:, 2] > 180).all()
    assert not inside[0, 0] and tuple(shown[0, 0]) == (124, 116, 104)
