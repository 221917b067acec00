"""Nearest neighbours against SciPy's tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dgc_pose.geometry.neighbours import nearest


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
