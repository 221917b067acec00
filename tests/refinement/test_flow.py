"""Optical flow guided by the dense map: it corrects the map's error."""

from __future__ import annotations

import dense_scene
import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap
from dgc_pose.refinement import FlowOptions
from dgc_pose.refinement.flow import FlowMatches


def _match(
    first: np.ndarray,
    second: np.ndarray,
    scene: CorrespondenceMap,
    long_side: int = 800,
    most: int = 900,
) -> Matches:
    options = FlowOptions(matchability=0.5, long_side=long_side, max_matches=most)
    none = Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), 1.0)
    return FlowMatches(options).find(Image(first), Image(second), scene, none)


def _off(found: Matches) -> np.ndarray:
    return np.linalg.norm(found.points1 - dense_scene.points_in_image1(found.points2), axis=1)


def test_an_error_of_some_pixels_is_corrected() -> None:
    """A smooth error of up to 4 pixels; flow alone could not find the scene's motion of 100."""
    truth = dense_scene.true_map()
    x, y = np.moveaxis(truth.grid, -1, 0)
    wrong = truth.map + np.stack([3 * np.sin(x / 40), 4 * np.cos(y / 60)], -1)
    scene = dense_scene.make_map(wrong, truth.grid)
    found = _match(*dense_scene.pictures(), scene)
    assert 300 < len(found) <= 900 and found.error_px == 0.5
    assert np.median(_off(found)) < 0.3 and (_off(found) < 1).mean() > 0.9


def test_at_half_the_size_the_error_is_twice_as_large() -> None:
    found = _match(*dense_scene.pictures(), dense_scene.true_map(), long_side=160)
    assert found.error_px == 1.0
    assert len(found) > 100 and np.median(_off(found)) < 0.6


def test_unrelated_pictures_have_few_consistent_pixels() -> None:
    first, second = dense_scene.pictures()
    same = _match(first, second, dense_scene.true_map(), most=10**6)
    other = _match(dense_scene.pictures(seed=5)[0], second, dense_scene.true_map(), most=10**6)
    assert len(same) > 40_000 and len(other) < 0.3 * len(same)


def test_matches_are_matchable_and_inside_both_images() -> None:
    scene = dense_scene.true_map()
    scene.matchability[:, :80] = 0.0
    found = _match(*dense_scene.pictures(), scene)
    assert len(found) > 100 and found.points2[:, 0].min() > 155
    assert (found.points1 >= -0.5).all() and (found.points1 <= (319.5, 239.5)).all()
    tiny = np.full((5, 300, 3), 90, np.uint8)
    assert len(_match(tiny, tiny, dense_scene.true_map())) == 0
