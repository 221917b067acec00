"""From matches to a pose or to a failure, on every kind of scene."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import K1, SIZE1, SIZE2, camera_scene, project, two_view_scene
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


def estimate(scene, matches=None, **options):
    matches = scene.matches if matches is None else matches
    return estimate_pose(matches, *scene.cameras, EstimationOptions(**options))


def as_matches(points1, points2, error_px=1.0):
    return Matches(points1, points2, np.ones(len(points1)), error_px)


def assert_no_pose(pose):
    assert not pose.success
    assert pose.t is None and pose.E is None and pose.cam2_from_cam1 is None
    assert pose.reason


@pytest.mark.parametrize("kind", ["general", "forward"])
def test_the_pose_of_a_solid_scene(kind):
    for seed in range(2):
        scene = two_view_scene(kind, seed=seed, count=1000, sigma_px=0.5, outliers=0.4)
        pose = estimate(scene)
        assert pose.status == "ok" and pose.success
        assert rotation_error_deg(pose.R, scene.R) < 0.2
        assert translation_error_deg(pose.t, scene.t) < 0.5
        assert np.linalg.norm(pose.t) == pytest.approx(1)
        np.testing.assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(pose.E, essential_from_pose(pose.R, pose.t))
        assert pose.inliers[scene.true].mean() > 0.9
        assert pose.inliers[~scene.true].mean() < 0.1
        assert pose.num_inliers == pose.inliers.sum()
        assert pose.inlier_ratio == pytest.approx(pose.inliers.mean())
        assert pose.evidence.cheirality_ratio > 0.95
        assert pose.evidence.homography_ratio < 0.2 and pose.alternatives == ()


@pytest.mark.parametrize(
    ("kind", "sigma_px", "count"),
    [
        ("rotation_only", 0.0, 60),
        ("rotation_only", 0.5, 200),
        ("rotation_only", 3.0, 3000),
        ("identical", 0.5, 200),  # exact copies are the same picture: test_overlay.py
        ("identical", 3.0, 60),
    ],
)
def test_cameras_in_one_place_give_a_rotation_and_no_translation(kind, sigma_px, count):
    scene = two_view_scene(kind, count=count, sigma_px=sigma_px, outliers=0.2)
    pose = estimate(scene, runs=1)
    assert_no_pose(pose)
    assert pose.status == "rotation_only" and pose.probability == 0
    assert rotation_error_deg(pose.R, scene.R) < 0.5 and len(pose.quaternion_wxyz) == 4


@pytest.mark.parametrize(("smooth", "degrees"), [(3, 0), (6, 90), (15, 0)])
def test_smooth_errors_of_dense_matches_are_no_translation(smooth, degrees):
    """A network's errors vary slowly over its grid of 60 x 60, and so look like parallax."""
    camera = Camera(np.array([[1700.0, 0, 799.5], [0, 1700, 599.5], [0, 0, 1]]))
    R = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    y, x = (np.mgrid[0:60, 0:60] + 0.5) * np.array([20, 1600 / 60])[:, None, None] - 0.5
    points2 = np.column_stack([x.ravel(), y.ravel()])
    rng = np.random.default_rng(0)
    error = np.stack(
        [gaussian_filter(rng.standard_normal((60, 60)), smooth).ravel() for _ in range(2)], 1
    )
    points1 = (points2 - (799.5, 599.5)) @ R[:2, :2] + (799.5, 599.5)
    points1 = points1 + 4.0 * error / error.std(0)
    pose = estimate_pose(as_matches(points1, points2, 4.0), camera, camera)
    assert pose.status == "rotation_only" and pose.t is None
    assert rotation_error_deg(pose.R, R) < 1.0


@pytest.mark.parametrize("baseline", [0.03, 0.3])
def test_a_small_but_real_baseline_is_a_pose(baseline):
    cameras = two_view_scene("general", count=1).cameras
    motion = {"turn_deg": (2.0, -3.0, 1.0), "centre": 6 * baseline * np.array([0.97, 0.1, 0.2])}
    scene = camera_scene(*cameras, outliers=0.3, **motion)
    pose = estimate(scene)
    assert pose.status == "ok"
    assert translation_error_deg(pose.t, scene.t) < 5


@pytest.mark.parametrize(
    ("count", "threshold_px", "focal_std", "seed"),
    [
        *((20, 10.0, 0.0, seed) for seed in range(3)),
        *((100, threshold_px, 0.0, seed) for threshold_px in (1.0, 20.0) for seed in range(2)),
        (1000, 1.0, 0.0, 0),
        (1000, 1.0, 0.4, 0),
        (10_000, 10.0, 0.0, 0),
    ],
)
def test_random_matches_never_give_a_pose(count, threshold_px, focal_std, seed):
    rng = np.random.default_rng(seed)
    matches = as_matches(rng.random((count, 2)) * SIZE1, rng.random((count, 2)) * SIZE2)
    cameras = (replace(camera, focal_std=focal_std) for camera in two_view_scene(count=1).cameras)
    options = EstimationOptions(threshold_px=threshold_px, runs=2, iterations=300)
    pose = estimate_pose(matches, *cameras, options)
    assert_no_pose(pose)
    assert pose.camera1 is None
    assert pose.R is None and pose.quaternion_wxyz is None
    assert pose.status in ("chance_inliers", "no_model")


@pytest.mark.parametrize("count", [0, 1, 19])
def test_too_few_matches_have_no_pose(count):
    scene = two_view_scene(count=20, outliers=0.0)
    pose = estimate(scene, as_matches(scene.points1[:count], scene.points2[:count]))
    assert_no_pose(pose)
    assert pose.status == "too_few_matches"
    assert pose.R is None
    assert pose.num_matches == count and pose.inliers.shape == (count,)
    assert str(count) in pose.reason


def test_most_points_behind_a_camera_are_a_failure():
    """Matches that fit one epipolar geometry, but half of them only behind the cameras."""
    rng = np.random.default_rng(3)
    X = rng.uniform(-1, 1, (600, 3)) * (3, 2, 1) + (0, 0, 6)
    X[:300] *= -1  # seen backwards: the same lines, a negative depth
    R = Rotation.from_rotvec([0.02, 0.1, 0.0]).as_matrix()
    points = project(X, K1), project(X, K1, R, np.array([-1.0, 0.1, 0.05]))
    camera = Camera(K1)  # some points lie outside its 1600 x 1200
    pose = estimate_pose(as_matches(*points), camera, camera)
    assert_no_pose(pose)
    assert pose.status == "behind_cameras"
    assert pose.R is None
    assert pose.evidence.cheirality_ratio < 0.6
    assert pose.num_inliers > 500


def test_the_same_seed_gives_the_same_answer_to_the_bit():
    scene = two_view_scene("planar", seed=1, count=400, sigma_px=2.0, outliers=0.5)
    first, again = (estimate(scene, seed=11) for _ in range(2))
    assert np.array_equal(first.R, again.R) and np.array_equal(first.t, again.t)
    assert np.array_equal(first.inliers, again.inliers)
    assert (first.status, first.warnings) == (again.status, again.warnings)
