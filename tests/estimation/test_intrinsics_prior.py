"""Sampson errors of deviating cameras, with and without lenses, and their derivatives, against
cameras that deviate and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import normalised_problem, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.intrinsics_prior import (
    EXACT,
    SIZE,
    IntrinsicsPrior,
    error_slopes,
    renormalised,
    with_parameters,
)
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance

BASIS = np.random.default_rng(3).standard_normal((2 * SIZE, 4)) * 0.02
OF_LENSES = [3, 4, SIZE + 3, SIZE + 4]
BASIS[OF_LENSES] = 0  # the lenses are known
DEVIATIONS = np.array([0.1, 0.01, -0.02, 0, 0, 0.05, -0.2, 0.03, 0.01, 0, 0, -0.04])
# Whose coefficients may deviate, and others.
RADIAL = [
    *(None, Distortion("RADIAL", (-0.1, 0.05)), Distortion("CYLINDER")),
    Distortion("OPENCV_FISHEYE", (0.02, -0.01, 0, 0)),
]
OTHERS = [
    *(Distortion("OPENCV", (-0.28, 0.07, 0.001, -0.001)), Distortion("SIMPLE_FISHEYE")),
    Distortion("OPENCV_FISHEYE", (0.02, -0.01, 0.002, 0)),
]
LENSES = [*RADIAL, *OTHERS]
SHIFT = np.array([0.04, -0.01, 0.02, 0, 0, 0.03])  # of one camera
SCENE = two_view_scene(outliers=0.0)
CAMERA = SCENE.cameras[0]
STDS = {"focal_std": 0.3, "centre_std": 17.0, "lens_std": 0.1, "aspect_std": 0.2}


@pytest.mark.parametrize("lens", LENSES)
def test_the_slopes_are_the_differences_of_the_errors(lens):
    """By a rotation, two coordinates of t, and the cameras, where these deviate already: of radial
    lenses in their coefficients too."""
    scene = two_view_scene("skew", count=50, outliers=0.0)
    basis, at = BASIS.copy(), DEVIATIONS
    if lens in RADIAL:
        basis[OF_LENSES] = np.random.default_rng(4).standard_normal((4, 4)) * 0.02
        at = DEVIATIONS + 0.03 * np.isin(np.arange(2 * SIZE), OF_LENSES[:3])
    through_lens = replace(CAMERA, distortion=lens), replace(CAMERA, distortion=lens)
    problem, prior = replace(scene.problem(), cameras=through_lens), IntrinsicsPrior(basis)
    _, slopes, tangent = error_slopes(problem, scene.R, scene.t, prior, at)
    assert slopes.shape == (50, 9)
    np.testing.assert_allclose(tangent.T @ tangent, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(tangent.T @ scene.t, 0, atol=1e-12)

    def errors(step):
        R = Rotation.from_rotvec(step[:3]).as_matrix() @ scene.R
        t = scene.t + tangent @ step[3:5]
        parameters = at + basis @ step[5:]
        return error_slopes(problem, R, t / np.linalg.norm(t), prior, parameters)[0]

    for k, step in enumerate(1e-5 * np.eye(9)):
        expected = (errors(step) - errors(-step)) / 2e-5
        np.testing.assert_allclose(slopes[:, k], expected, atol=2e-4 if lens in OTHERS else 1e-6)


def test_the_errors_are_those_of_points_that_the_deviating_cameras_normalise():
    """Up to the unit, which stays that of the cameras before."""
    scene = two_view_scene("skew", count=50, outliers=0.0)
    problem = scene.problem()
    errors, _, _ = error_slopes(problem, scene.R, scene.t, IntrinsicsPrior(BASIS), DEVIATIONS)
    moved1 = renormalised(problem.points1, None, DEVIATIONS[:SIZE])
    moved2 = renormalised(problem.points2, None, DEVIATIONS[SIZE:])
    expected = sampson_distance(moved1, moved2, essential_from_pose(scene.R, scene.t))
    expected *= np.exp(DEVIATIONS[[0, SIZE]].mean())
    np.testing.assert_allclose(np.abs(errors), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("identity", "same_size", "columns"), [("a", True, 6), ("a", False, 8), (None, True, 12)]
)
def test_one_camera_has_one_focal_length_and_one_centre_for_one_size(identity, same_size, columns):
    camera1, camera2 = two_view_scene(same_camera=True).cameras
    camera1, camera2 = (
        replace(camera, **STDS, identity=identity)
        for camera in (camera1, camera2 if same_size else replace(camera2, size=(1200, 1600)))
    )
    prior = IntrinsicsPrior.of(camera1, camera2)
    assert len(prior) == columns
    covariance = prior.basis @ prior.basis.T
    np.testing.assert_allclose(covariance[0, SIZE], 0.09 if identity else 0)
    np.testing.assert_allclose(covariance[3, SIZE + 3], 0.01 if identity else 0)
    np.testing.assert_allclose(covariance[5, SIZE + 5], 0.04 if identity else 0)
    np.testing.assert_allclose(covariance[1, SIZE + 1] > 0, identity is not None and same_size)
    shift = 17.0 / camera1.focal
    stds = 2 * [0.3, shift, shift, 0.1, 0.2, 0.2]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), stds)


@pytest.mark.parametrize(
    ("source", "centre_std", "shared"),
    [("size", 15.0, True), ("size", 17.0, False), ("exif", 17.0, False), ("given", 17.0, True)],
)
def test_parts_of_larger_images_share_no_principal_point(source, centre_std, shared):
    """Whose principal point nobody stated, and is off the middle by over 1 % of 1600 pixels."""
    camera = replace(CAMERA, centre_std=centre_std, focal_source=source, identity="a")
    for other in (camera, replace(camera, centre_std=1.0)):
        for pair in ((camera, other), (other, camera)):
            prior = IntrinsicsPrior.of(*pair)
            assert len(prior) == (2 if shared else 4)
            assert (prior.basis[1] @ prior.basis[SIZE + 1] > 0) == shared


def test_a_match_at_both_epipoles_has_no_slope_rather_than_nan():
    points = np.zeros((1, 2))
    problem = normalised_problem(points, points)
    for prior in (EXACT, IntrinsicsPrior(BASIS)):
        errors, slopes, _ = error_slopes(problem, np.eye(3), np.array([0.0, 0, 1]), prior)
        assert np.isfinite(errors).all() and np.isfinite(slopes).all()


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_what_the_deviating_camera_makes_of_the_pixels(lens):
    camera, points = replace(CAMERA, distortion=lens), CAMERA.normalise(SCENE.points1)
    expected = with_parameters(camera, SHIFT).normalise(camera.project(points))
    np.testing.assert_allclose(renormalised(points, lens, SHIFT), expected, atol=1e-12)
