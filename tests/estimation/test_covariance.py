from dataclasses import replace

import numpy as np
import pytest
from scenes import normalised_problem, two_view_scene
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.covariance import error_radius_deg, pose_covariance
from dgc_pose.estimation.intrinsics_prior import FOCALS, IntrinsicsPrior
from dgc_pose.estimation.least_squares import CORRELATED
from dgc_pose.estimation.problem import Hypothesis, pose_loss_width
from dgc_pose.estimation.robust_fit import least_squares_pose
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

SCALE = 2e-3


def normalised(count):
    """A scene and its points, without noise."""
    scene = two_view_scene(count=count, sigma_px=0.0, outliers=0.0)
    problem = scene.problem()
    return scene, problem.points1, problem.points2


@pytest.mark.parametrize("variances", [(4.0, 0, 0), (1.0, 1, 1), (3.0, 2, 0), (9.0, 1, 0.1)])
def test_nine_lengths_in_ten_are_below_the_radius(variances):
    """And it is that of SciPy's chi-square of the same mean and variance."""
    covariance = np.diag(variances) * 1e-6
    R = Rotation.random(random_state=3).as_matrix()
    radius = error_radius_deg(R @ covariance @ R.T)
    drawn = np.random.default_rng(0).standard_normal((200_000, 3)) * np.sqrt(np.diag(covariance))
    lengths = np.degrees(np.linalg.norm(drawn, axis=1))
    assert (lengths < radius).mean() == pytest.approx(0.9, abs=0.035)
    mean, squares = np.trace(covariance), np.trace(covariance**2)
    quantile = squares / mean * chi2.ppf(0.9, mean**2 / squares)
    assert radius == pytest.approx(np.degrees(np.sqrt(quantile)), rel=1e-9)
    assert (error_radius_deg(0 * covariance), error_radius_deg(1e12 * covariance)) == (0, 180)


def refitted(points1, points2, scene, key_points=True):
    """The pose that the covariance is of: a Cauchy fit at its own scale."""
    problem = normalised_problem(points1, points2, 4 * SCALE, key_points=key_points)
    scale = pose_loss_width(problem, scene.R, scene.t)
    pose = Hypothesis.of_pose(problem, *least_squares_pose(problem, scene.R, scene.t, scale))
    covariance = pose_covariance(problem, pose)
    return pose.R, pose.t, covariance[0]


def test_the_covariance_is_that_of_poses_from_other_noise():
    clean, first, second = normalised(800)
    rng = np.random.default_rng(0)
    rotations, shifts, stated, dense = [], [], [], []
    for _ in range(60):
        noisy = [p + 4e-4 * rng.standard_normal(p.shape) for p in (first, second)]
        R, t, covariance = refitted(*noisy, clean)
        dense.append(refitted(*noisy, clean, key_points=False)[2] - covariance)
        rotations.append(Rotation.from_matrix(R @ clean.R.T).as_rotvec())
        shifts.append(t - clean.t)
        stated.append(covariance)
    drawn = np.cov(np.column_stack([rotations, shifts]).T)
    mean = np.mean(stated, axis=0)
    assert mean.shape == (6, 6)
    np.testing.assert_allclose(mean, mean.T, atol=1e-18)
    for part in (slice(0, 3), slice(3, 6)):
        ratio = np.trace(mean[part, part]) / np.trace(drawn[part, part])
        assert 0.8 < ratio < 2.0  # leaving out a block in ten is on the careful side
        # To that of a dense map the usual covariance is added, of a tenth of the matches.
        added = np.trace(np.mean(dense, axis=0)[part, part]) / np.trace(drawn[part, part])
        assert 0.75 * CORRELATED < added < 1.4 * CORRELATED
    np.testing.assert_allclose(mean[3:, 3:] @ clean.t, 0, atol=0.05 * np.trace(mean[3:, 3:]))


def test_a_camera_that_is_not_fitted_moves_the_pose():
    """What it adds is the covariance of poses by other focal lengths, of matches without noise."""
    scene, points1, points2 = normalised(800)
    std = 0.004
    camera = replace(scene.cameras[0], focal_std=std, identity="one")
    prior = IntrinsicsPrior.of(camera, camera)
    rng = np.random.default_rng(0)
    noise = 1e-5 * rng.standard_normal(points2.shape)
    rotations, shifts, stated = [], [], []
    for k in std * np.sqrt(2) * np.sin(np.arange(20) * np.pi / 10):
        points = points1 * np.exp(-k), (points2 + noise) * np.exp(-k)
        problem = normalised_problem(*points, 4 * SCALE)
        scale = pose_loss_width(problem, scene.R, scene.t)
        pose = Hypothesis.of_pose(problem, *least_squares_pose(problem, scene.R, scene.t, scale))
        covariance, by_cameras = pose_covariance(problem, pose, prior, fitted=False)
        rotations.append(Rotation.from_matrix(pose.R @ scene.R.T).as_rotvec())
        shifts.append(pose.t - scene.t)
        stated.append(covariance - pose_covariance(problem, pose)[0])
        assert np.sqrt(by_cameras.diagonal()[FOCALS]) == pytest.approx((std, std))
    drawn = np.cov(np.column_stack([rotations, shifts]).T, bias=True)
    mean = np.mean(stated, axis=0)
    for part in (slice(0, 3), slice(3, 6)):
        assert 0.8 < np.trace(mean[part, part]) / np.trace(drawn[part, part]) < 1.25


def test_errors_that_neighbours_share_make_the_pose_less_certain():
    scene, points1, points2 = normalised(900)
    rng = np.random.default_rng(1)
    noise = 4e-4 * rng.standard_normal(points2.shape)
    patch = np.unique(np.floor(points2 / 0.15), axis=0, return_inverse=True)[1].ravel()
    shared = 4e-4 * rng.standard_normal((patch.max() + 1, 2))[patch]
    radii = []
    for error in (noise, shared):
        R, t, covariance = refitted(points1, points2 + error, scene)
        radii.append(error_radius_deg(covariance[:3, :3]))
        assert rotation_error_deg(R, scene.R) < 2 * radii[-1]
    assert radii[1] > 2.5 * radii[0]


def test_matches_in_one_spot_have_no_covariance():
    points = np.full((30, 2), 0.1)
    every = np.ones(30, dtype=bool)
    pose = Hypothesis(np.eye(3), np.array([1.0, 0, 0]), inliers=every, in_front=every)
    assert pose_covariance(normalised_problem(points, points, SCALE), pose) is None


def test_nine_errors_in_ten_are_below_those_of_the_pose():
    within = []
    for seed in range(20):
        scene = two_view_scene(seed=seed, count=300, sigma_px=1.0, outliers=0.3)
        pose = estimate_pose(scene.matches, *scene.cameras, EstimationOptions(runs=1))
        assert pose.covariance.shape == (6, 6)
        within += [
            rotation_error_deg(pose.R, scene.R) <= pose.rotation_error_90_deg,
            translation_error_deg(pose.t, scene.t) <= pose.translation_error_90_deg,
        ]
    assert 0.8 <= np.mean(within) <= 1.0


def test_the_number_of_threads_changes_no_digit():
    scene = two_view_scene(count=3000, outliers=0.0)
    problem = scene.problem()
    loose = [replace(camera, focal_std=0.3, centre_std=5.0) for camera in scene.cameras]
    pose = Hypothesis.of_pose(problem, scene.R, scene.t)
    covariances = []
    for threads in (1, 2, 4):
        with threadpool_limits(threads):
            covariances.append(pose_covariance(problem, pose, IntrinsicsPrior.of(*loose)))
    for other in covariances[1:]:
        for mine, first in zip(other, covariances[0], strict=True):
            np.testing.assert_array_equal(mine, first)
