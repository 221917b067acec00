"""What the dense map shows: points, rotation and scale."""

from __future__ import annotations

import dense_scene
import numpy as np
import pytest

from dgc_pose.matching import CorrespondenceMap
from dgc_pose.refinement.guide import (
    points_in_image1,
    rotate_points,
    rotation_between,
    scale_between,
)


def test_points_between_cells_lie_on_the_surface() -> None:
    rng = np.random.default_rng(0)
    points2 = rng.uniform((5, 5), (314, 234), (40000, 2))  # more than one remap takes in a side
    found = points_in_image1(dense_scene.true_map(), points2)
    np.testing.assert_allclose(found, dense_scene.points_in_image1(points2), atol=0.02)


def test_beyond_the_outer_cells_the_map_is_constant() -> None:
    scene = dense_scene.true_map()
    corner = points_in_image1(scene, np.array([[-30.0, -30.0]]))[0]
    np.testing.assert_allclose(corner, scene.map[0, 0], atol=1e-4)


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_rotated_points_follow_the_pixels(quarter_turns: int) -> None:
    values = np.arange(7 * 5).reshape(7, 5)
    points = np.array([[0, 0], [4, 0], [2, 6], [3, 1]])
    x, y = rotate_points(points.astype(float), (5, 7), quarter_turns).astype(int).T
    assert np.array_equal(np.rot90(values, quarter_turns)[y, x], values[points[:, 1], points[:, 0]])
    rotated_size = (5, 7) if quarter_turns % 2 == 0 else (7, 5)
    back = rotate_points(np.stack([x, y], -1), rotated_size, -quarter_turns)
    assert np.array_equal(back, points)


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_the_map_shows_the_rotation_of_image_2(quarter_turns: int) -> None:
    """Image 2 such that rot90 gives it the orientation of image 1 up to 20 degrees."""
    axis = np.arange(24.0)
    grid = np.stack(np.meshgrid(axis, axis), -1)
    upright = rotate_points(grid.reshape(-1, 2), (24, 24), quarter_turns) - 11.5
    angle = np.radians(20)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points1 = (upright @ rotation.T * 0.7 + 40).reshape(24, 24, 2)
    matchability = np.full((24, 24), 0.9, np.float32)
    points1[:3], matchability[:3] = 500.0, 0.1  # cells of low matchability do not count
    found = CorrespondenceMap(
        points1.astype(np.float32), grid.astype(np.float32), matchability, (80, 80), (24, 24)
    )
    assert rotation_between(found) == quarter_turns
    assert rotation_between(found, matchability=0.95) == 0


@pytest.mark.parametrize("scale", [0.3, 1.0, 2.5])
def test_the_map_shows_the_scale(scale: float) -> None:
    """Rotated, sheared at constant area, noisy, and wrong at low matchability."""
    rng = np.random.default_rng(0)
    axis = np.arange(60.0)
    grid = np.stack(np.meshgrid(5 * axis, 4 * axis), -1)  # cells of 5 by 4 pixels
    angle = np.radians(70)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shear = np.array([[1.25, 0.4], [0.0, 0.8]])
    points1 = grid @ (scale * rotation @ shear).T + rng.normal(0, 0.1, grid.shape)
    matchability = np.full((60, 60), 0.9, np.float32)
    points1[:25], matchability[:25] = rng.uniform(0, 900, (25, 60, 2)), 0.1
    found = CorrespondenceMap(
        points1.astype(np.float32), grid.astype(np.float32), matchability, (900, 900), (300, 240)
    )
    assert scale_between(found) == pytest.approx(scale, rel=0.03)
    assert scale_between(found, matchability=0.95) == 1.0
