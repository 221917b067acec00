"""From a map to matches: every filter, and an even spread."""

from dataclasses import replace

import numpy as np

from dgc_pose.matching.correspondence_map import CorrespondenceMap
from dgc_pose.matching.selection import MatchingOptions, select_matches


def _map(seed: int = 0, side: int = 60) -> CorrespondenceMap:
    rng = np.random.default_rng(seed)
    axis = (np.arange(side) + 0.5) * 10 - 0.5
    grid = np.stack(np.meshgrid(axis, axis), -1).astype(np.float32)
    points1 = grid + rng.normal(0, 3, grid.shape).astype(np.float32)
    matchability = rng.random((side, side)).astype(np.float32)
    return CorrespondenceMap(points1, grid, matchability, (600, 600), (600, 600))


def test_filters_against_a_loop() -> None:
    correspondence_map = _map()
    options = MatchingOptions(matchability=0.6, max_matches=10_000)
    found = select_matches(correspondence_map, options)
    expected = []
    for row in range(60):
        for column in range(60):
            x, y = correspondence_map.map[row, column]
            inside = -0.5 <= x <= 599.5 and -0.5 <= y <= 599.5
            sure = correspondence_map.matchability[row, column] >= 0.6
            if inside and sure:
                expected.append((x, y, *correspondence_map.grid[row, column]))
    assert 300 < len(expected) < 1500
    np.testing.assert_array_equal(
        np.column_stack([found.points1, found.points2]), np.array(expected, dtype=np.float64)
    )
    assert found.confidence.min() >= 0.6


def test_at_most_so_many_are_taken_evenly_spread_and_the_confident_first() -> None:
    dense = _map()
    for least in (0.98, 0.7, 0.1):
        for most in (1, 7, 100, 3600):
            found = select_matches(dense, MatchingOptions(matchability=least, max_matches=most))
            count = int((dense.matchability >= least).sum())
            assert 1 <= len(found) <= most and (len(found) > 0.9 * count or count > 0.9 * most)
    sure = replace(dense, map=dense.grid)
    found = select_matches(sure, MatchingOptions(matchability=0.0, max_matches=225))
    quarters = np.unique(found.points2 // 150, axis=0, return_counts=True)[1]
    assert len(quarters) == 16 and quarters.min() > 0.7 * quarters.max()
    assert found.confidence.mean() > 0.8


def test_a_small_patch_is_no_match() -> None:
    correspondence_map = _map()
    few = np.zeros_like(correspondence_map.matchability)
    few[10:14, 10:14] = 0.9
    patch = replace(correspondence_map, matchability=few)
    assert len(select_matches(patch, MatchingOptions(), 0.01)) == 0
    assert len(select_matches(patch, MatchingOptions(), 0.0)) == 16
