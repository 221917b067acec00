"""Fisheyes against pycolmap's, cylinders against their rays, and derivatives against differences.
Lenses of a plane are in tests/cameras/test_camera.py."""

import numpy as np
import pycolmap
import pytest

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.geometry.radial import distorted, undistorted, undistorted_gradient

POINTS = np.random.default_rng(0).uniform(-0.55, 0.55, (200, 2))
# Normalised points up to 80 degrees from the axis, and the axis itself.
ANGLES = np.radians(np.random.default_rng(1).uniform(0, 80, 200))
TURNS = np.random.default_rng(2).uniform(0, 2 * np.pi, 200)
WIDE = np.tan(ANGLES)[:, None] * np.column_stack([np.cos(TURNS), np.sin(TURNS)])
WIDE[0] = 0


@pytest.mark.parametrize("lens", [(0.0, 0.0), (0.05, -0.01), (-0.02, 0.003)])
def test_angles_are_those_of_the_fisheye_of_colmap(lens: tuple[float, float]) -> None:
    camera = pycolmap.Camera.create_from_model_name(0, "OPENCV_FISHEYE", 1.0, 1, 1)
    camera.params = [1.0, 1.0, 0.0, 0.0, *lens, 0.0, 0.0]
    seen = camera.img_from_cam(np.column_stack([WIDE, np.ones(len(WIDE))]))
    own = Distortion("OPENCV_FISHEYE", (*lens, 0.0, 0.0))
    np.testing.assert_allclose(own.apply(WIDE), seen, atol=1e-9)
    np.testing.assert_allclose(own.undo(seen), WIDE, rtol=1e-6, atol=1e-9)


def test_a_cylinder_is_that_of_its_rays() -> None:
    """A point (x, y) of it is seen along (sin x, y, cos x)."""
    seen = np.random.default_rng(3).uniform((-1.5, -2.0), (1.5, 2.0), (200, 2))
    rays = np.column_stack([np.sin(seen[:, 0]), seen[:, 1], np.cos(seen[:, 0])])
    points = rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(Distortion("CYLINDER").undo(seen), points, rtol=1e-9)
    np.testing.assert_allclose(Distortion("CYLINDER").apply(points), seen, atol=1e-9)


@pytest.mark.parametrize("lens", [(0.09, -0.2), (-0.3, 0.08), (0.0, 0.0)])
def test_the_slopes_are_the_differences_of_undistorted_points(lens: tuple[float, float]) -> None:
    seen, step = distorted(POINTS, lens), 1e-6
    gradient = np.random.default_rng(5).standard_normal((2, len(seen)))
    by_seen, by_lens = undistorted_gradient(undistorted(seen, lens), lens, gradient)
    for k, unit in enumerate(step * np.eye(2)):
        by_point = undistorted(seen + unit, lens) - undistorted(seen - unit, lens)
        expected = (gradient * by_point.T).sum(0) / (2 * step)
        np.testing.assert_allclose(by_seen[k], expected, atol=1e-5)
        by_coefficient = undistorted(seen, lens + unit) - undistorted(seen, lens - unit)
        expected = (gradient * by_coefficient.T).sum(0) / (2 * step)
        np.testing.assert_allclose(by_lens[k], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("lens", "places"),
    [
        # Beyond the largest radius: r (1 - 0.2 r^2) is at most 0.86. At 90 degrees and beyond.
        (Distortion("RADIAL", (-0.2, 0.0)), [(0.9, 0.0)]),
        (Distortion("FISHEYE"), [(1.6, 0.0), (0.0, -1.6), (1.2, 1.2), (4.0, 0.0)]),
        (Distortion("CYLINDER"), [(1.6, 0.0), (-1.6, 0.3), (4.0, 0.0)]),
    ],
)
def test_where_no_ray_is_seen_there_is_no_point(lens, places) -> None:
    assert np.isnan(lens.undo(np.array(places))).all()
    inside = np.array(places) * 0.8 / np.abs(places).max()
    assert np.isfinite(lens.undo(inside)).all()
