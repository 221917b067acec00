"""The lens of two coefficients against pycolmap's RADIAL, and its derivatives by differences."""

import numpy as np
import pycolmap
import pytest

from dgc_pose.geometry.radial import distorted, undistorted, undistorted_slopes

POINTS = np.random.default_rng(0).uniform(-0.55, 0.55, (200, 2))
LENSES = [(0.09, -0.2), (-0.3, 0.08), (0.4, 0.1), (-0.1, 0.0), (0.0, 0.0)]


@pytest.mark.parametrize("lens", LENSES)
def test_it_is_that_of_colmap(lens: tuple[float, float]) -> None:
    camera = pycolmap.Camera.create_from_model_name(0, "RADIAL", 1.0, 1, 1)
    camera.params = [1.0, 0.0, 0.0, *lens]
    seen = camera.img_from_cam(np.column_stack([POINTS, np.ones(len(POINTS))]))
    np.testing.assert_allclose(distorted(POINTS, lens), seen, atol=1e-12)
    np.testing.assert_allclose(undistorted(seen, lens), POINTS, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_the_slopes(lens: tuple[float, float]) -> None:
    seen, step = distorted(POINTS, lens), 1e-6
    by_seen, by_lens = undistorted_slopes(undistorted(seen, lens), lens)
    for k, unit in enumerate(step * np.eye(2)):
        of_point = undistorted(seen + unit, lens) - undistorted(seen - unit, lens)
        np.testing.assert_allclose(by_seen[:, :, k], of_point / (2 * step), atol=1e-6)
        of_lens = undistorted(seen, lens + unit) - undistorted(seen, lens - unit)
        np.testing.assert_allclose(by_lens[:, :, k], of_lens / (2 * step), atol=1e-6)


def test_beyond_the_largest_radius_nothing_is_undone() -> None:
    seen = np.array([[0.5, 0.0], [0.9, 0.0]])  # r (1 - 0.2 r^2) is at most 0.86
    undone = undistorted(seen, (-0.2, 0.0))
    assert np.isfinite(undone[0]).all() and np.isnan(undone[1]).all()
