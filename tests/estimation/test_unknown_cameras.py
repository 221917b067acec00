"""Poses of cameras that are not exact."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import pinhole, two_view_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions, estimate_pose


def _unknown(camera: Camera, identity: str | None = None, factor: float = 1.3) -> Camera:
    """A camera whose focal length is off, as that of an image without a K is."""
    assumed, centre_std = pinhole(factor * camera.focal, camera.size), 0.01 * max(camera.size)
    return replace(assumed, focal_std=0.4, centre_std=centre_std, identity=identity)


def _error(pose, scene) -> float:
    return max(scene.errors_deg(pose))


@pytest.mark.parametrize(("seed", "factor"), [(0, 0.6), (1, 1.0), (2, 1.7)])
def test_the_matches_tell_the_focal_length_of_one_camera(seed, factor):
    scene = two_view_scene("skew", seed=seed, same_camera=True, count=1500)
    cameras = (_unknown(camera, "a", factor) for camera in scene.cameras)
    pose = estimate_pose(scene.matches, *cameras)
    assert pose.success and _error(pose, scene) < 1
    for camera in (pose.camera1, pose.camera2):
        assert camera.focal_source == "matches"
        error = abs(np.log(camera.focal / scene.cameras[0].focal))
        assert error < 0.03 and error < 3 * camera.focal_std < 0.15
    np.testing.assert_array_equal(pose.camera1.K, pose.camera2.K)


@pytest.mark.parametrize("seed", range(2))
def test_the_focal_lengths_of_two_cameras_are_as_far_off_as_they_say(seed):
    scene = two_view_scene("skew", seed=seed, count=1500)
    cameras, options = map(_unknown, scene.cameras), EstimationOptions(min_probability=0.3)
    pose = estimate_pose(scene.matches, *cameras, options)
    assert pose.success and _error(pose, scene) < 5
    for camera, true in zip((pose.camera1, pose.camera2), scene.cameras, strict=True):
        assert abs(np.log(camera.focal / true.focal)) < 3 * camera.focal_std < 1.3


def test_a_camera_that_is_known_stays_as_it_is():
    scene = two_view_scene("skew", count=1500)
    camera1, camera2 = scene.cameras
    pose = estimate_pose(scene.matches, camera1, _unknown(camera2))
    assert pose.camera1 is camera1
    assert abs(np.log(pose.camera2.focal / camera2.focal)) < 0.05
    assert _error(pose, scene) < 1


@pytest.mark.parametrize("known_focal", [True, False])
def test_a_lens_that_is_not_known_is_fitted(known_focal):
    """Against the pose of a camera that is taken for a pinhole, and against the lens."""
    scene = two_view_scene("skew", same_camera=True, count=1500)
    lens = Distortion("RADIAL", (0.09, -0.2))
    seen = [
        replace(camera, distortion=lens).project(camera.normalise(points))
        for camera, points in zip(scene.cameras, (scene.points1, scene.points2), strict=True)
    ]
    matches = replace(scene.matches, points1=seen[0], points2=seen[1])
    pinholes = [
        replace(camera, identity="a") if known_focal else _unknown(camera, "a", 1.1)
        for camera in scene.cameras
    ]
    pose = estimate_pose(matches, *(replace(camera, lens_std=0.1) for camera in pinholes))
    limit, offset = (0.5, 3e-3) if known_focal else (1.5, 8e-3)
    assert _error(pose, scene) < min(limit, _error(estimate_pose(matches, *pinholes), scene))
    assert pose.camera1.distortion == pose.camera2.distortion
    radius = np.linspace(0.05, 0.5, 10)[:, None] * [[0.8, 0.6]]
    fitted = pose.camera1.distortion.apply(radius)
    np.testing.assert_allclose(fitted, lens.apply(radius), atol=offset)
    assert 0 < pose.camera1.lens_std < 0.1


@pytest.mark.parametrize(("focal_std", "aspect_std"), [(0.0, 0.0), (0.02, 0.05), (0.4, 0.1)])
def test_the_deviations_of_a_fitted_camera_are_the_roots_of_the_covariance(focal_std, aspect_std):
    """And none is wider than it was stated: all are calibrated by the focal length's factor."""
    scene = two_view_scene("skew", same_camera=True, count=1500)
    stated = (replace(_unknown(c, "a", 1.1), lens_std=0.1) for c in scene.cameras)
    stated = [replace(c, focal_std=focal_std, aspect_std=aspect_std) for c in stated]
    pose = estimate_pose(scene.matches, *stated)
    roots = np.sqrt(np.diag(pose.camera_covariance)).reshape(2, 6)
    for root, camera, before in zip(roots, (pose.camera1, pose.camera2), stated, strict=True):
        centre = np.sqrt((root[1:3] ** 2).mean())
        expected = {"focal": root[0], "centre": centre, "lens": root[3], "aspect": root[5]}
        for name, std in expected.items():
            assert getattr(camera, f"{name}_std") == pytest.approx(std, rel=1e-9)
            assert getattr(camera, f"{name}_std") <= getattr(before, f"{name}_std")
        assert 0 < camera.lens_std <= before.lens_std and camera.centre_std > 0


@pytest.mark.parametrize("seed", range(3))
def test_pixels_that_are_not_square_are_fitted_within_their_deviation(seed):
    scene = two_view_scene("skew", seed=seed, same_camera=True, count=1500)
    stretch = np.diag([0, 0.06 * scene.K1[1, 1], 0])
    stated = [
        replace(c, K=c.K + stretch, aspect_std=0.05, focal_std=0.05, identity="a")
        for c in scene.cameras
    ]
    pose = estimate_pose(scene.matches, *stated)
    ratio = scene.K1[1, 1] / scene.K1[0, 0]
    for camera in (pose.camera1, pose.camera2):
        assert abs(np.log(camera.K[1, 1] / camera.K[0, 0] / ratio)) < 3 * camera.aspect_std < 0.08
    rotation, translation = scene.errors_deg(pose)
    assert rotation < 2 * pose.rotation_error_90_deg < 2
    assert translation < 2 * pose.translation_error_90_deg < 4


def test_where_the_axes_meet_the_focal_length_is_uncertain():
    scene = two_view_scene("orbit", same_camera=True, count=1500, outliers=0.1)
    pose = estimate_pose(scene.matches, *(_unknown(camera, "a") for camera in scene.cameras))
    assert pose.camera1.focal_std > 0.1 and pose.rotation_error_90_deg > 1
    percent = 100 * pose.camera1.focal_std
    (warning,) = pose.warnings
    focal = pose.camera1.focal
    assert warning == f"the focal length is uncertain: f = {focal:.0f} px within {percent:.0f} %"


def test_a_wrong_K_with_a_deviation_has_a_warning():
    scene = two_view_scene("skew", same_camera=True, count=1500)
    cameras = (
        replace(c.with_focal(1.3 * c.focal), focal_std=0.02, identity="a") for c in scene.cameras
    )
    pose = estimate_pose(scene.matches, *cameras)
    (warning,) = pose.warnings
    assert warning.startswith("the matches agree with ") and ", and K states " in warning
    stated = max(pose.rotation_error_90_deg, pose.translation_error_90_deg)
    assert _error(pose, scene) < 3 * stated


@pytest.mark.parametrize(("factor", "contradicted"), [(1.9, True), (1.05, False)])
def test_exif_data_that_the_matches_contradict_have_a_warning(factor, contradicted):
    scene = two_view_scene("skew", same_camera=True, count=1500)
    of_exif = {"focal_std": 0.06, "centre_std": 8.0, "focal_source": "exif", "identity": "a"}
    pose = estimate_pose(
        scene.matches, *(replace(c.with_focal(factor * c.focal), **of_exif) for c in scene.cameras)
    )
    says = f"EXIF states {factor * scene.cameras[0].focal:.0f}"
    assert any(says in warning for warning in pose.warnings) == contradicted


def test_the_deviation_of_K_widens_the_expected_error():
    scene = two_view_scene("orbit", same_camera=True, count=1500, sigma_px=0.3)
    exact = estimate_pose(scene.matches, *scene.cameras)
    loose = estimate_pose(
        scene.matches, *(replace(c, focal_std=0.05, identity="a") for c in scene.cameras)
    )
    assert loose.rotation_error_90_deg > 1.5 * exact.rotation_error_90_deg
    assert _error(loose, scene) < 3 * max(
        loose.rotation_error_90_deg, loose.translation_error_90_deg
    )


def test_random_matches_of_unknown_cameras_are_no_pose():
    scene = two_view_scene("random", same_camera=True)
    pose = estimate_pose(scene.matches, *(_unknown(camera, "a") for camera in scene.cameras))
    assert not pose.success and pose.camera1 is None
