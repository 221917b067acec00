"""Measurements of a pose against loops, exact arithmetic, and scenes whose truth is known."""

import math

import numpy as np
import pytest
from scenes import CELLS, normalised_problem, project, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.estimation.evidence import chance_ratio, log10_false_alarms, measured
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.verdict import judge
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance

THRESHOLD = 2e-3
LEAST = 0.5  # probability of a success


@pytest.mark.parametrize("sigma_px", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_after_a_pure_rotation_the_parallax_is_one_whatever_translation_is_claimed(seed, sigma_px):
    scene = two_view_scene("rotation_only", seed=seed, count=600, sigma_px=sigma_px, outliers=0.2)
    problem = scene.problem(THRESHOLD, CELLS)
    t = Rotation.random(random_state=seed).as_matrix()[0]
    evidence = measured(problem, Hypothesis.of_pose(problem, scene.R, t))
    low, high = (0.0, 1e-3) if sigma_px == 0 else (0.75, 1.3)
    assert low <= evidence.parallax <= high
    assert evidence.rotation_share > 0.8
    assert judge(evidence, LEAST).status == "rotation_only"


def test_the_parallax_grows_with_the_baseline():
    parallaxes = []
    for baseline in (0.02, 0.06, 0.18):
        rng = np.random.default_rng(0)
        X = rng.uniform(-1, 1, (500, 3)) * (3, 2, 2) + (0, 0, 6)
        exact = project(X, np.eye(3)), project(X + (baseline, 0, 0), np.eye(3))
        points = [seen + 3e-4 * rng.standard_normal((500, 2)) for seen in exact]
        problem = normalised_problem(*points, 4e-3, CELLS)
        pose = Hypothesis.of_pose(problem, np.eye(3), np.array([1.0, 0, 0]))
        parallaxes.append(measured(problem, pose).parallax)
    assert 1.3 < parallaxes[0] < parallaxes[1] / 2 < parallaxes[2] / 4


def test_inliers_on_one_line_are_collinear():
    scene = two_view_scene("general", count=100, sigma_px=0.0, outliers=0.0)
    X = np.linspace(-1, 1, 100)[:, None] * (1.0, 0.5, 0.3) + (0, 0, 5)
    points = project(X, np.eye(3)), project(X, np.eye(3), scene.R, scene.t)
    problem = normalised_problem(*points, THRESHOLD, CELLS)
    pose = Hypothesis.of_pose(problem, scene.R, scene.t)
    assert pose.inliers.all()
    assert measured(problem, pose).collinear


def test_inliers_crowded_in_a_few_spots_occupy_few_cells():
    scene = two_view_scene("general", count=400, sigma_px=0.0, outliers=0.0)
    whole = scene.problem(THRESHOLD, CELLS)
    points1, points2 = whole.points1, whole.points2

    def evidence_of(problem):
        return measured(problem, Hypothesis.of_pose(problem, scene.R, scene.t))

    counted = (
        {tuple(cell) for cell in np.floor(points1 / 0.05)},
        {tuple(cell) for cell in np.floor(points2 / 0.05)},
    )
    assert evidence_of(whole).occupied_cells == min(map(len, counted)) > 100
    # Eight of the points, each a hundred times within a hair: as many inliers, few cells.
    rng = np.random.default_rng(0)
    few = np.repeat(np.arange(8), 100)
    near1 = points1[few] + 1e-5 * rng.standard_normal((800, 2))
    near2 = points2[few] + 1e-5 * rng.standard_normal((800, 2))
    crowded = evidence_of(normalised_problem(near1, near2, THRESHOLD, CELLS))
    assert crowded.num_inliers > 700
    assert crowded.occupied_cells <= 12
    assert judge(crowded, LEAST).status == "chance_inliers"
    # Key points are independent.
    independent = evidence_of(normalised_problem(near1, near2, THRESHOLD, CELLS, key_points=True))
    assert independent.key_points and independent.occupied_cells == crowded.occupied_cells
    assert judge(independent, LEAST).status == "ok"


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
    ratio = chance_ratio(normalised_problem(points1, points2, 0.02, seed=3), E)
    assert ratio == pytest.approx((hits + 1) / (40 * 39 + 1))


def test_a_draw_of_many_matches_tells_the_same():
    rng = np.random.default_rng(4)
    points1, points2 = rng.uniform(-0.5, 0.5, (2, 9000, 2))
    E = essential_from_pose(np.eye(3), np.array([0.6, 0.0, 0.8]))
    wrong = [np.roll(np.arange(9000), shift) for shift in range(1, 30)]
    every = np.mean([sampson_distance(points1, points2[i], E) < 0.05 for i in wrong])
    ratio = chance_ratio(normalised_problem(points1, points2, 0.05, seed=5), E)
    assert ratio == pytest.approx(every, rel=0.1)


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
    assert log10_false_alarms(1000, 5, 1e-6) == math.inf  # a minimal sample
