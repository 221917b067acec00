"""The chance level against loops and exact arithmetic, and what it keeps out."""

import math

import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.evidence import chance_ratio, log10_false_alarms
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.matches import Matches
from two_view import normalised_problem, two_view_scene


def test_the_chance_level_is_the_share_of_inliers_among_all_wrong_pairs():
    rng = np.random.default_rng(1)
    points1, points2 = rng.uniform(-0.5, 0.5, (2, 40, 2))
    E = essential_from_pose(np.eye(3), np.array([0.6, 0.0, 0.8]))
    hits = sum(
        sampson_distance(points1[i : i + 1], points2[j : j + 1], E)[0] < 0.02
        for i in range(40)
        for j in range(40)
        if i != j
    )
    assert hits > 20
    found = chance_ratio(normalised_problem(points1, points2, 0.02, seed=3), E)
    assert found == pytest.approx((hits + 1) / (40 * 39 + 1))


def test_of_many_matches_a_draw_tells_the_same():
    rng = np.random.default_rng(4)
    points1, points2 = rng.uniform(-0.5, 0.5, (2, 9000, 2))
    E = essential_from_pose(np.eye(3), np.array([0.6, 0.0, 0.8]))
    wrong = [np.roll(np.arange(9000), shift) for shift in range(1, 30)]
    every = np.mean([sampson_distance(points1, points2[i], E) < 0.05 for i in wrong])
    found = chance_ratio(normalised_problem(points1, points2, 0.05, seed=5), E)
    assert found == pytest.approx(every, rel=0.1)


def test_right_matches_do_not_raise_the_chance_level():
    scene = two_view_scene("general", seed=31, count=400, sigma_px=0.0, outliers=0.0)
    problem = scene.problem(threshold=1e-6)
    E = essential_from_pose(scene.R, scene.t)
    assert (sampson_distance(problem.points1, problem.points2, E) < 1e-6).all()
    assert chance_ratio(problem, E) < 1e-3


def test_matches_that_all_end_in_one_point_agree_by_chance_alone():
    points1 = np.random.default_rng(2).uniform(-0.5, 0.5, (50, 2))
    points2 = np.tile([[0.1, -0.2]], (50, 1))
    E = essential_from_pose(np.eye(3), np.array([0.1, -0.2, 1.0]))  # its epipole is that point
    assert chance_ratio(normalised_problem(points1, points2, 0.01), E) == 1


@pytest.mark.parametrize(
    ("count", "inliers", "chance"), [(100, 21, 0.04), (20, 20, 0.01), (57_600, 223, 0.002)]
)
def test_false_alarms_are_those_of_exact_arithmetic(count, inliers, chance):
    samples = (count - 5) * math.comb(count, inliers) * math.comb(inliers, 5)
    expected = math.log10(samples) + (inliers - 5) * math.log10(chance)
    assert log10_false_alarms(count, inliers, chance) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("inliers", [0, 5])
def test_a_minimal_sample_proves_nothing(inliers):
    assert log10_false_alarms(1000, inliers, 1e-6) == math.inf


@pytest.mark.parametrize(("size", "threshold_px"), [((240, 240), 3.0), ((1600, 1200), 20.0)])
def test_random_matches_get_no_pose_under_a_wide_threshold(size, threshold_px):
    """A fifth of a hundred random matches agree there, five times the chance of each alone."""
    focal = 1.2 * max(size)
    camera = Camera(np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]]), size)
    options = EstimationOptions(threshold_px=threshold_px)
    ratios = []
    for seed in range(300, 306):
        points1, points2 = np.random.default_rng(seed).random((2, 100, 2)) * size
        matches = Matches(points1, points2, np.ones(100), 1.0)
        pose = estimate_pose(matches, camera, camera, options)
        assert pose.status == "chance_inliers" and not pose.success
        assert pose.R is None and pose.t is None and pose.E is None
        ratios.append(pose.inlier_ratio)
    assert max(ratios) > 0.15
