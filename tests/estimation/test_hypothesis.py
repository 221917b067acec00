import numpy as np
import pytest
from scenes import two_view_scene

from dgc_pose.estimation.problem import Hypothesis, pose_loss_width
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance

THRESHOLD = 2e-3


@pytest.mark.parametrize("scale", [1.0, -2.0])
def test_of_four_poses_the_one_with_points_in_front_is_chosen(scale):
    scene = two_view_scene(count=60, sigma_px=0.0, outliers=0.0)
    E = essential_from_pose(scene.R, scene.t)
    pose = Hypothesis.of_essential(scene.problem(), scale * E)
    assert np.abs(pose.R - scene.R).max() < 1e-6 and np.abs(pose.t - scene.t).max() < 1e-6
    assert pose.in_front.all()


def test_the_scale_follows_the_errors_between_a_floor_and_the_threshold():
    for sigma_px, expected in ((0.0, 0.02 * THRESHOLD), (30.0, THRESHOLD)):
        scene = two_view_scene(count=300, sigma_px=sigma_px, outliers=0.0)
        assert pose_loss_width(scene.problem(THRESHOLD), scene.R, scene.t) == expected
    scene = two_view_scene(count=4000, sigma_px=0.5, outliers=0.0)
    problem = scene.problem(THRESHOLD)
    E = essential_from_pose(scene.R, scene.t)
    error = sampson_distance(problem.points1, problem.points2, E)
    # Gaussian errors: 2.385 of their standard deviations (Rey 1983).
    scale = pose_loss_width(problem, scene.R, scene.t)
    assert scale == pytest.approx(2.385 * np.sqrt((error**2).mean()), rel=0.05)
