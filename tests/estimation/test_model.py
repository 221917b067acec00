import numpy as np
import pytest

from dgc_pose.estimation.model import Model, pose_error_scale
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from two_view import two_view_scene

THRESHOLD = 2e-3


def test_of_four_poses_the_one_with_points_in_front_is_chosen():
    for seed in range(5):
        scene = two_view_scene(seed=seed, count=60, sigma_px=0.0, outliers=0.0)
        E = essential_from_pose(scene.R, scene.t)
        for scale in (1.0, -2.0):
            model = Model.of_essential(scene.problem(), scale * E)
            assert np.abs(model.R - scene.R).max() < 1e-6
            assert np.abs(model.t - scene.t).max() < 1e-6
            assert model.in_front.all()


def test_the_inliers_are_those_below_the_threshold():
    scene = two_view_scene(count=200, sigma_px=1.0)
    problem = scene.problem(THRESHOLD)
    model = Model.of_pose(problem, scene.R, scene.t)
    E = essential_from_pose(scene.R, scene.t)
    distance = sampson_distance(problem.points1, problem.points2, E)
    assert np.array_equal(model.inliers, distance < THRESHOLD)
    assert model.count == (distance < THRESHOLD).sum()
    assert model.count_in_front == (model.in_front & (distance < THRESHOLD)).sum()


def test_the_scale_follows_the_errors_between_a_floor_and_the_threshold():
    for sigma_px, expected in ((0.0, 0.02 * THRESHOLD), (30.0, THRESHOLD)):
        scene = two_view_scene(count=300, sigma_px=sigma_px, outliers=0.0)
        assert pose_error_scale(scene.problem(THRESHOLD), scene.R, scene.t) == expected
    scene = two_view_scene(count=4000, sigma_px=0.5, outliers=0.0)
    problem = scene.problem(THRESHOLD)
    E = essential_from_pose(scene.R, scene.t)
    error = sampson_distance(problem.points1, problem.points2, E)
    # Gaussian errors: 2.385 of their standard deviations (Rey 1983).
    scale = pose_error_scale(problem, scene.R, scene.t)
    assert scale == pytest.approx(2.385 * np.sqrt((error**2).mean()), rel=0.05)
