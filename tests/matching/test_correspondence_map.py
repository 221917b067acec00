"""What the dense map shows: points, rotation, scale, the parts that match; and matches from it."""

from dataclasses import replace

import dense_scene
import numpy as np
import pytest

from dgc_pose.images.image import Image
from dgc_pose.matching.correspondence_map import (
    CorrespondenceMap,
    MatchingOptions,
    matchable_points,
    points_in_image1,
    rotation_between,
    scale_between,
    select_matches,
    window_shown,
)
from dgc_pose.matching.view import View


def test_points_between_cells_lie_on_the_surface() -> None:
    rng = np.random.default_rng(0)
    points2 = rng.uniform((5, 5), (314, 234), (40000, 2))  # more than one remap takes in a side
    found = points_in_image1(dense_scene.true_map(), points2)
    np.testing.assert_allclose(found, dense_scene.points_in_image1(points2), atol=0.02)


@pytest.mark.parametrize("angle", [-150.0, 0.0, 75.0])
def test_the_map_shows_the_rotation_of_image_2(angle: float) -> None:
    """Image 2 such that it has the orientation of image 1 when it is rotated by the angle."""
    grid = dense_scene.grid(24, 24, (24, 24))
    upright = View.whole(Image(np.zeros((24, 24, 3), np.uint8)), angle).to_view(grid)
    points1 = 0.7 * upright + 20
    points1[:3] = 500.0
    found = dense_scene.make_map(points1, grid, ((80, 80), (24, 24)), 0.9)
    found.matchability[:3] = 0.1  # such cells do not count
    assert rotation_between(*matchable_points(found)) == pytest.approx(angle, abs=1e-3)
    assert len(matchable_points(found)[0]) == 21 * 24
    found.matchability[:] = 0.4
    few = matchable_points(found)
    assert rotation_between(*few) == 0 == len(few[0])


def test_a_window_holds_the_points_with_a_margin() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((100, 50), (180, 90), (2000, 2))
    points[:10] = 600.0  # fewer than one in a hundred do not count
    (width, height), centre = window_shown(points, (640, 480))
    assert 115 < width < 130 and 55 < height < 65
    assert centre == pytest.approx((140, 70), abs=2)
    # Of whole pixels, and within the image.
    assert centre[0] % 1 == (0.5 if width % 2 == 0 else 0.0)
    (width, height), centre = window_shown(points - (100, 50), (640, 480))
    assert centre[0] - (width - 1) / 2 == centre[1] - (height - 1) / 2 == 0


@pytest.mark.parametrize("scale", [0.3, 2.5])
def test_the_map_shows_the_scale(scale: float) -> None:
    """Rotated, sheared at constant area, noisy, and wrong at low matchability."""
    rng = np.random.default_rng(0)
    grid = dense_scene.grid(60, 60, (300, 240))
    angle = np.radians(70)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shear = np.array([[1.25, 0.4], [0.0, 0.8]])
    points1 = grid @ (scale * rotation @ shear).T + rng.normal(0, 0.1, grid.shape)
    points1[:25] = rng.uniform(0, 900, (25, 60, 2))
    found = dense_scene.make_map(points1, grid, ((900, 900), (300, 240)), 0.9)
    found.matchability[:25] = 0.1
    assert scale_between(found) == pytest.approx(scale, rel=0.03)
    equal_fields = np.sqrt(900 * 900 / (300 * 240))
    found.matchability[:] = 0.4
    assert scale_between(found) == pytest.approx(equal_fields)


def _map(seed: int = 0, side: int = 60) -> CorrespondenceMap:
    rng = np.random.default_rng(seed)
    grid = dense_scene.grid(side, side, (600, 600))
    points1 = grid + rng.normal(0, 3, grid.shape)
    return dense_scene.make_map(points1, grid, ((600, 600),) * 2, rng.random((side, side)))


def test_confident_cells_whose_match_lies_in_image_1_are_taken_evenly_spread() -> None:
    dense = _map()
    inside = ((dense.map >= -0.5) & (dense.map <= 599.5)).all(-1)
    rows = inside & (dense.matchability >= 0.6)
    found = select_matches(dense, MatchingOptions(max_matches=10_000), min_matchability=0.6)
    np.testing.assert_array_equal(found.points1, dense.map[rows])
    np.testing.assert_array_equal(found.points2, dense.grid[rows])
    sure = replace(dense, map=dense.grid)
    found = select_matches(sure, MatchingOptions(max_matches=225), 0.01, 0.0)
    quarters = np.unique(found.points2 // 150, axis=0, return_counts=True)[1]
    assert len(quarters) == 16 and quarters.min() > 0.7 * quarters.max()
    assert 0.9 * 225 < len(found) <= 225 and found.confidence.mean() > 0.8


def test_a_small_patch_is_no_match() -> None:
    correspondence_map = _map()
    few = np.zeros_like(correspondence_map.matchability)
    few[10:14, 10:14] = 0.9
    patch = replace(correspondence_map, matchability=few)
    assert len(select_matches(patch, MatchingOptions(), 0.01)) == 0
    assert len(select_matches(patch, MatchingOptions(), 0.0)) == 16
