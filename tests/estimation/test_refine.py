import numpy as np

from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.robust_fit import refine, refit, sample
from dgc_pose.metrics import translation_error_deg
from two_view import normalised_problem, two_view_scene

THRESHOLD = 2e-3


def test_refinement_brings_a_rough_pose_to_the_truth():
    scene = two_view_scene(count=600, sigma_px=0.3, outliers=0.3)
    problem = scene.problem(5e-3)
    rough = scene.t + (0.02, 0.02, -0.02)
    rough /= np.linalg.norm(rough)
    after = refine(problem, Hypothesis.of_pose(problem, scene.R, rough))
    assert after.inliers[scene.true].all()
    assert translation_error_deg(after.t, scene.t) < 0.2 * translation_error_deg(rough, scene.t)


def test_refinement_does_not_lose_inliers():
    for seed in range(4):
        problem = two_view_scene(seed=seed, count=150, sigma_px=2.0, outliers=0.6).problem()
        plain = sample(problem, EstimationOptions(runs=2))[0]
        assert refine(problem, plain).num_inliers >= 0.94 * plain.num_inliers


def test_at_the_scale_of_their_errors_poor_inliers_do_not_bias_the_pose():
    """Most inliers are ten times better than the threshold, and one in five lies anywhere in it."""
    gains = []
    for seed in range(5):
        scene = two_view_scene(seed=seed, count=600, sigma_px=0.2, outliers=0.0)
        exact = scene.problem()
        points2 = exact.points2.copy()
        rng = np.random.default_rng(seed)
        poor = rng.random(600) < 0.2
        points2[poor] += rng.uniform(0, THRESHOLD, (poor.sum(), 2))  # all to one side
        problem = normalised_problem(exact.points1, points2, THRESHOLD)
        before = refine(problem, Hypothesis.of_pose(problem, scene.R, scene.t))
        after = refit(problem, before, adapt_scale=True)
        assert after.num_inliers >= 0.98 * before.num_inliers
        gains.append([pose.angle_to(scene.R, scene.t) for pose in (before, after)])
    worse, better = np.mean(gains, axis=0)
    assert better < 0.6 * worse


def test_five_inliers_are_too_few_for_a_fit():
    scene = two_view_scene(count=100, outliers=0.0)
    problem = scene.problem().subset(np.arange(100) < 5)
    pose = Hypothesis.of_pose(problem, scene.R, scene.t)
    assert refit(problem, pose, adapt_scale=True) is pose and refine(problem, pose) is pose
