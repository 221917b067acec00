"""The dense map as a guide, and quarter turns."""

from __future__ import annotations

import dense_scene
import numpy as np
import pytest

from dgc_pose.matching import CorrespondenceMap
from dgc_pose.refinement.guide import places_in_image1, quarter_turns, turned_points, zoom_between


def test_places_between_cells_lie_where_the_surface_is() -> None:
    rng = np.random.default_rng(0)
    points2 = rng.uniform((5, 5), (314, 234), (40000, 2))  # more than one remap takes in a side
    found = places_in_image1(dense_scene.true_map(), points2)
    np.testing.assert_allclose(found, dense_scene.places_in_image1(points2), atol=0.02)


def test_beyond_the_outer_cells_the_map_goes_on_as_it_ends() -> None:
    scene = dense_scene.true_map()
    corner = places_in_image1(scene, np.array([[-30.0, -30.0]]))[0]
    np.testing.assert_allclose(corner, scene.map[0, 0], atol=1e-4)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_turned_points_follow_the_pixels(turns: int) -> None:
    values = np.arange(7 * 5).reshape(7, 5)
    points = np.array([[0, 0], [4, 0], [2, 6], [3, 1]])
    x, y = turned_points(points.astype(float), (5, 7), turns).astype(int).T
    assert np.array_equal(np.rot90(values, turns)[y, x], values[points[:, 1], points[:, 0]])
    turned_size = (5, 7) if turns % 2 == 0 else (7, 5)
    back = turned_points(np.stack([x, y], -1), turned_size, -turns)
    assert np.array_equal(back, points)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_the_map_shows_how_image_2_is_turned(turns: int) -> None:
    """Image 2 such that rot90 by `turns` makes it stand like image 1, roughly: 20 degrees off."""
    axis = np.arange(24.0)
    grid = np.stack(np.meshgrid(axis, axis), -1)
    upright = turned_points(grid.reshape(-1, 2), (24, 24), turns) - 11.5
    angle = np.radians(20)
    lean = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places = (upright @ lean.T * 0.7 + 40).reshape(24, 24, 2)
    matchability = np.full((24, 24), 0.9, np.float32)
    places[:3], matchability[:3] = 500.0, 0.1  # what the map is not sure of does not count
    found = CorrespondenceMap(
        places.astype(np.float32), grid.astype(np.float32), matchability, (80, 80), (24, 24)
    )
    assert quarter_turns(found) == turns
    assert quarter_turns(found, matchability=0.95) == 0


@pytest.mark.parametrize("zoom", [0.3, 1.0, 2.5])
def test_the_map_shows_how_much_larger_things_are(zoom: float) -> None:
    """Turned, sheared without a change of area, noisy, and wrong where it is not sure."""
    rng = np.random.default_rng(0)
    axis = np.arange(60.0)
    grid = np.stack(np.meshgrid(5 * axis, 4 * axis), -1)  # cells of 5 by 4 pixels
    angle = np.radians(70)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shear = np.array([[1.25, 0.4], [0.0, 0.8]])
    places = grid @ (zoom * turn @ shear).T + rng.normal(0, 0.1, grid.shape)
    matchability = np.full((60, 60), 0.9, np.float32)
    places[:25], matchability[:25] = rng.uniform(0, 900, (25, 60, 2)), 0.1
    found = CorrespondenceMap(
        places.astype(np.float32), grid.astype(np.float32), matchability, (900, 900), (300, 240)
    )
    assert zoom_between(found) == pytest.approx(zoom, rel=0.03)
    assert zoom_between(found, matchability=0.95) == 1.0
