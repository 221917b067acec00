"""Depths at inliers: how many tell a length, and what depths tell of their kind."""

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.estimation.depth_length import Rays, length_by_depths, ray_probability

R, T = np.eye(3), np.array([1.0, 0.0, 0.0])
DEVIATING = [(R, np.array([1.0, 0.001, 0.0]) / np.hypot(1, 0.001))]


def exact(x1: np.ndarray) -> tuple[Rays, np.ndarray]:
    """Inliers at normalised points (N, 2) of image 1, and their depths (2, N) in both images. The
    cameras are one unit apart per unit of the points."""
    z = np.random.default_rng(0).uniform(4, 6, len(x1))
    points = np.column_stack([x1 * z[:, None], z])
    moved = points + T * np.abs(x1).max()
    return (x1, moved[:, :2] / moved[:, 2:]), np.stack([z, moved[:, 2]])


def test_an_inlier_with_two_depths_is_one() -> None:
    rays, z = exact(np.random.default_rng(1).uniform(-0.3, 0.3, (6, 2)))
    with pytest.raises(InputError, match="^6 inliers have a depth, and 10 are needed$"):
        length_by_depths(rays, z, 0.02, 0.1, R, T)
    assert ray_probability(rays, z, 0.02, (R, T), DEVIATING) == pytest.approx(0.1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("field", ["one ring", 1e-6, 1e-8, 1e-9])
def test_secants_that_are_equal_tell_no_kind(field: float | str) -> None:
    """Points at one angle to the optical axis, or next to the axis."""
    if field == "one ring":
        x1 = np.repeat([[0.3, 0], [-0.3, 0], [0, 0.3], [0, -0.3]], 15, axis=0)
    else:
        x1 = np.random.default_rng(1).uniform(-field, field, (60, 2))
    rays, z = exact(x1)
    z[1] = np.nan
    assert ray_probability(rays, z, 0.02, (R, T), DEVIATING) == pytest.approx(0.1)
