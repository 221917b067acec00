"""Nearest neighbours against SciPy's tree, and an even choice of points."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dgc_pose.geometry.sampling import nearest, nearest_to, spread


def _grid() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), -1).reshape(-1, 2)


@pytest.mark.parametrize(
    "points",
    [
        np.random.default_rng(1).uniform(0, 4000, (3000, 2)),
        _grid(),
        np.repeat(_grid()[::9], 20, axis=0),
        np.full((50, 2), 7.0),
        np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]]),
    ],
    ids=["anywhere", "a grid", "many at each place", "all at one place", "few"],
)
def test_the_distances_are_scipys_and_the_indices_lead_to_them(points: np.ndarray) -> None:
    count = min(13, len(points))
    distance, index = nearest(points, count)
    expected, _ = cKDTree(points).query(points, k=count)
    np.testing.assert_allclose(distance, expected, atol=1e-2)
    reached = np.linalg.norm(points[index] - points[:, None], axis=-1)
    np.testing.assert_allclose(np.sort(reached, 1), expected, atol=1e-2)
    assert all(len(set(row)) == count for row in index.tolist())


def test_the_nearest_of_other_points_are_scipys_to_the_bit() -> None:
    """Also of points that single precision cannot tell apart."""
    rng = np.random.default_rng(2)
    points = np.concatenate([rng.uniform(0, 6000, (2000, 2)), 5000 + rng.uniform(0, 1e-4, (3, 2))])
    queries = np.concatenate([rng.uniform(-10, 6010, (5000, 2)), points[-3:] + 1e-6])
    distance, index = nearest_to(queries, points)
    expected, its_index = cKDTree(points).query(queries)
    np.testing.assert_array_equal(index, its_index)
    np.testing.assert_allclose(distance, expected, rtol=1e-12)


def test_without_points_all_are_infinitely_far_and_without_queries_there_are_none() -> None:
    some, none = np.ones((3, 2)), np.zeros((0, 2))
    assert np.isinf(nearest_to(some, none)[0]).all()
    assert [len(part) for part in nearest_to(none, some)] == [0, 0]


def test_spread_keeps_the_strongest_of_each_block() -> None:
    points = np.array([[10.0, 10.0], [12.0, 11.0], [200.0, 10.0], [10.0, 200.0]])
    strength = np.array([1.0, 2.0, 0.1, 0.2])
    assert spread(points, strength, (300, 300), 10).tolist() == [0, 1, 2, 3]
    assert spread(points, strength, (300, 300), 3).tolist() == [1, 2, 3]
    assert spread(points[:0], strength[:0], (300, 300), 3).tolist() == []
