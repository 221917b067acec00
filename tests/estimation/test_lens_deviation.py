"""Deviations of K through a lens, against cameras that deviate."""

from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import estimate_pose
from dgc_pose.estimation.camera_spread import CameraSpread, deviating
from dgc_pose.estimation.lens_deviation import deviated, deviated_slopes
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.slopes import error_slopes
from two_view import two_view_scene

LENSES = [None, Distortion("OPENCV", (-0.28, 0.07, 0.001, -0.001)), Distortion("SIMPLE_FISHEYE")]
DEVIATIONS = np.array([0.04, -0.01, 0.02])
SCENE = two_view_scene(outliers=0.0)


def through(lens: Distortion | None, **changes) -> tuple[list[Camera], TwoViewProblem, object]:
    """Cameras of short focal lengths with the lens, and the scene's matches as these see them."""
    cameras, points = [], []
    for pinhole, pixels in zip(SCENE.cameras, (SCENE.points1, SCENE.points2), strict=True):
        K = pinhole.K * [[0.6], [0.6], [1]]
        cameras.append(Camera(K, pinhole.size, lens, **changes))
        points.append(cameras[-1].project(pinhole.normalise(pixels)))
    matches = replace(SCENE.matches, points1=points[0], points2=points[1])
    return cameras, TwoViewProblem.of(matches, *cameras), matches


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_what_the_deviating_camera_makes_of_the_pixels(lens):
    (camera, _), problem, matches = through(lens)
    expected = deviating(camera, DEVIATIONS).normalise(matches.points1[problem.index])
    moved = deviated(problem.points1, lens, DEVIATIONS)
    # The shift is over both focal lengths, each by its own: these differ by some per cent.
    np.testing.assert_allclose(moved, expected, atol=1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_the_slopes_are_the_differences(lens):
    _, problem, _ = through(lens)
    slopes = deviated_slopes(problem.points1, lens, DEVIATIONS)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        ahead, behind = (deviated(problem.points1, lens, DEVIATIONS + s) for s in (step, -step))
        np.testing.assert_allclose(slopes[:, :, axis], (ahead - behind) / 2e-5, atol=1e-3)


def test_the_slopes_of_a_lens_without_distortion_are_those_of_a_pinhole():
    flat = Distortion("OPENCV", (0.0, 0.0, 0.0, 0.0))
    (camera1, camera2), problem, _ = through(None, focal_std=0.1, centre_std=5.0)
    spread = CameraSpread.of(camera1, camera2)
    expected = error_slopes(problem, SCENE.R, SCENE.t, spread)
    bent = error_slopes(replace(problem, lenses=(flat, flat)), SCENE.R, SCENE.t, spread)
    np.testing.assert_allclose(bent[0], expected[0], atol=1e-9)
    np.testing.assert_allclose(bent[1], expected[1], atol=1e-5)


@pytest.mark.parametrize("lens", LENSES)
def test_a_focal_length_within_its_deviation_is_fitted(lens):
    cameras, _, matches = through(lens, focal_std=0.05, identity="x")
    wrong = [deviating(camera, np.array([0.05, 0, 0])) for camera in cameras]
    pose = estimate_pose(matches, *wrong)
    assert pose.camera1.focal_std < 0.02
    assert pose.camera1.focal == pytest.approx(cameras[0].focal, rel=3 * pose.camera1.focal_std)
