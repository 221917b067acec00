"""Derivatives of Sampson errors by pose and cameras, against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.estimation.camera_spread import CameraSpread, deviating, normaliser
from dgc_pose.estimation.slopes import error_slopes
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from two_view import normalised_problem, two_view_scene

BASIS = np.random.default_rng(3).standard_normal((6, 4)) * 0.02
DEVIATIONS = np.array([0.1, 0.01, -0.02, -0.2, 0.03, 0.01])


def _moved(problem, scene, tangent, step):
    """The errors of a pose and of deviations that are a step (9,) away."""
    R = Rotation.from_rotvec(step[:3]).as_matrix() @ scene.R
    t = scene.t + tangent @ step[3:5]
    deviations = DEVIATIONS + BASIS @ step[5:]
    return error_slopes(problem, R, t / np.linalg.norm(t), CameraSpread(BASIS), deviations)[0]


def test_the_slopes_are_the_differences_of_the_errors():
    scene = two_view_scene("skew", count=50, outliers=0.0)
    problem = scene.problem()
    spread = CameraSpread(BASIS)
    _, slopes, tangent = error_slopes(problem, scene.R, scene.t, spread, DEVIATIONS)
    assert slopes.shape == (50, 9)
    for k, step in enumerate(1e-6 * np.eye(9)):
        above, below = (_moved(problem, scene, tangent, sign * step) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (above - below) / 2e-6, atol=1e-6)


def test_the_errors_are_those_of_points_that_the_deviating_cameras_normalise():
    """Up to the unit, which stays that of the cameras before."""
    scene = two_view_scene("skew", count=50, outliers=0.0)
    camera1, camera2 = scene.cameras
    errors, _, _ = error_slopes(scene.problem(), scene.R, scene.t, CameraSpread(BASIS), DEVIATIONS)
    first, second = deviating(camera1, DEVIATIONS[:3]), deviating(camera2, DEVIATIONS[3:])
    E = essential_from_pose(scene.R, scene.t)
    A1, A2 = normaliser(DEVIATIONS[:3]), normaliser(DEVIATIONS[3:])
    np.testing.assert_allclose(
        np.abs(errors),
        sampson_distance(
            camera1.normalise(scene.points1), camera2.normalise(scene.points2), A2.T @ E @ A1
        ),
        atol=1e-14,
    )
    for points, camera, other, A in (
        (scene.points1, camera1, first, A1),
        (scene.points2, camera2, second, A2),
    ):
        ideal = camera.normalise(points) @ A[:2, :2].T + A[:2, 2]
        # fx and fy differ, the shift is over fx and over fy.
        np.testing.assert_allclose(ideal, other.normalise(points), atol=1e-12)


@pytest.mark.parametrize(
    ("identity", "same_size", "columns"), [("a", True, 3), ("a", False, 5), (None, True, 6)]
)
def test_one_camera_has_one_focal_length_and_of_one_size_one_centre(identity, same_size, columns):
    camera1, camera2 = two_view_scene(same_camera=True).cameras
    camera1, camera2 = (
        replace(camera, focal_std=0.3, centre_std=17.0, identity=identity)
        for camera in (camera1, camera2 if same_size else replace(camera2, size=(1200, 1600)))
    )
    spread = CameraSpread.of(camera1, camera2)
    assert len(spread) == columns
    covariance = spread.basis @ spread.basis.T
    np.testing.assert_allclose(covariance[0, 3], 0.09 if identity else 0)
    np.testing.assert_allclose(covariance[1, 4] > 0, identity is not None and same_size)
    shift = 17.0 / camera1.focal
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.3, shift, shift, 0.3, shift, shift])
    assert spread.shared_focal == (identity is not None)


def test_exact_cameras_have_no_spread():
    assert len(CameraSpread.of(*two_view_scene().cameras)) == 0


def test_a_match_at_both_epipoles_has_no_slope_rather_than_nan():
    points = np.zeros((1, 2))
    problem = normalised_problem(points, points)
    _, slopes, _ = error_slopes(problem, np.eye(3), np.array([0.0, 0, 1]), CameraSpread(BASIS))
    assert np.isfinite(slopes).all()
