"""Runs of RANSAC have the inliers of COLMAP's, and differ by their seeds; refinement comes nearer
to the truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import poselib
import pycolmap
import pytest
from scenes import normalised_problem, pinhole, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.estimation import EstimationOptions, estimate_pose, robust_fit
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.robust_fit import (
    best_planar,
    essential_matrix,
    refine,
    refit,
    sample,
)
from dgc_pose.geometry.epipolar import sampson_distance
from dgc_pose.geometry.homography import fit_homography
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

THRESHOLD = 2e-3  # of the scenes


def _inliers(problem, E):
    return sampson_distance(problem.points1, problem.points2, E) < problem.threshold


def _unit(E):
    """E up to its scale and sign."""
    E = E / np.linalg.norm(E)
    return E * np.sign(E.flat[np.abs(E).argmax()])


def test_a_run_has_as_many_inliers_as_colmaps():
    problem = two_view_scene(seed=4, count=300, sigma_px=1.0, outliers=0.3).problem()
    focal = 1000.0  # COLMAP expects pixels
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=2, height=2, params=[focal, 0, 0])
    ransac = pycolmap.RANSACOptions(max_error=problem.threshold * focal, random_seed=0)
    pixels = problem.points1 * focal, problem.points2 * focal
    theirs = pycolmap.estimate_essential_matrix(*pixels, camera, camera, ransac)["E"]
    ours = essential_matrix(problem, 1)
    assert _inliers(problem, ours).sum() > 0.97 * _inliers(problem, theirs).sum() > 150


def test_a_run_is_as_long_as_its_inliers_ask_for(monkeypatch):
    iterations = []

    def counted(*arguments):
        pose, info = poselib.estimate_relative_pose(*arguments)
        iterations.append(info["iterations"])
        return pose, info

    monkeypatch.setattr(robust_fit, "poselib", SimpleNamespace(estimate_relative_pose=counted))
    for outliers in (0.0, 0.2, 0.6):
        problem = two_view_scene(seed=4, count=300, sigma_px=0.2, outliers=outliers).problem()
        essential_matrix(problem, 1)
    clean, some, many = iterations
    assert 50 <= clean < 100 < some < 900 < many <= 1001


@pytest.mark.parametrize("count", [400, 5000])
def test_the_runs_differ_are_scored_on_all_matches_and_ordered_by_their_inliers(count):
    """Of 5000 matches each run draws 3000."""
    scene = two_view_scene(seed=1, count=count, sigma_px=3.0, outliers=0.5)
    problem = replace(scene.problem(), options=EstimationOptions(runs=6, iterations=20))
    poses = sample(problem)
    assert len({_unit(pose.E).round(9).tobytes() for pose in poses}) == 6
    counts = [pose.num_inliers for pose in poses]
    assert counts == sorted(counts, reverse=True)
    for pose in poses:
        again = Hypothesis.of_pose(problem, pose.R, pose.t)
        assert pose.inliers.shape == (count,) and np.array_equal(pose.inliers, again.inliers)
    other = sample(replace(problem, options=replace(problem.options, seed=1)), 1)
    assert _unit(other[0].E).tobytes() not in {_unit(pose.E).tobytes() for pose in poses}


def test_refinement_brings_a_rough_pose_to_the_truth():
    scene = two_view_scene(count=600, sigma_px=0.3, outliers=0.3)
    problem = scene.problem(5e-3)
    rough = scene.t + (0.02, 0.02, -0.02)
    rough /= np.linalg.norm(rough)
    after = refine(problem, Hypothesis.of_pose(problem, scene.R, rough))
    assert after.inliers[scene.true].all()
    assert translation_error_deg(after.t, scene.t) < 0.2 * translation_error_deg(rough, scene.t)


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
        after = refit(problem, before, adapt_width=True)
        assert after.num_inliers >= 0.98 * before.num_inliers
        gains.append([pose.angle_to(scene.R, scene.t) for pose in (before, after)])
    worse, better = np.mean(gains, axis=0)
    assert better < 0.6 * worse


SIZE = (1600, 1200)
K = pinhole(1500, SIZE).K
TURN = Rotation.from_rotvec([0.05, 0.15, 0.1]).as_matrix()
ROLL = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()


ZOOMED = pinhole(1.3 * 1500, SIZE).K


@pytest.mark.parametrize("refined", [False, True])
def test_a_plane_brings_a_wrong_pose_back_to_a_right_one(refined: bool) -> None:
    scene = two_view_scene("planar", count=500, sigma_px=0.2, outliers=0.3)
    problem = scene.problem()
    right = problem.subset(scene.true)
    H = fit_homography(right.points1, right.points2, problem.threshold)
    wrong = Hypothesis.of_pose(problem, np.eye(3), np.array([0.0, 0, 1]))
    assert best_planar(problem, wrong, H, refined).angle_to(scene.R, scene.t) < 2


@pytest.mark.parametrize(
    ("H", "R", "identity"),
    [
        (np.array([[1, 0, -150], [0, 1, 80], [0, 0, 1.0]]), np.eye(3), "shared"),
        (np.array([[1.4, 0, -420], [0, 1.4, -10], [0, 0, 1.0]]), np.eye(3), None),
        (ZOOMED @ np.linalg.inv(K), np.eye(3), "shared"),
        (K @ ROLL @ np.linalg.inv(K), ROLL, None),
        (K @ TURN @ np.linalg.inv(K), TURN, "shared"),
        (ZOOMED @ TURN @ np.linalg.inv(K), TURN, None),
    ],
    ids=["crop", "enlarged", "zoom", "roll", "turn", "turn and zoom"],
)
def test_a_camera_that_did_not_move_has_no_pose(H, R, identity) -> None:
    rng = np.random.default_rng(4)
    points1 = rng.random((1200, 2)) * SIZE
    moved = np.column_stack([points1, np.ones(1200)]) @ H.T
    points2 = moved[:, :2] / moved[:, 2:] + 0.2 * rng.standard_normal((1200, 2))
    seen = ((points2 > 0) & (points2 < SIZE)).all(1)  # in both images
    points1, points2 = points1[seen], points2[seen]
    wrong = rng.random(len(points2)) < 0.1
    points2[wrong] = rng.random((wrong.sum(), 2)) * SIZE
    matches = Matches(points1, points2, np.ones(len(points2)), error_px=0.5)
    prior = pinhole(1760, SIZE)  # by the size
    prior = replace(prior, focal_std=0.45, centre_std=8.0, identity=identity)
    pose = estimate_pose(matches, prior, prior)
    assert pose.status == "rotation_only" and pose.t is None and pose.probability == 0
    assert rotation_error_deg(pose.R, R) < 2


def test_five_matches_are_enough_and_four_are_not():
    problem = two_view_scene(seed=3, count=5, sigma_px=0.0, outliers=0.0).problem()
    E = essential_matrix(problem, 1)
    assert sampson_distance(problem.points1, problem.points2, E).max() < 1e-6
    assert sample(problem.subset(np.arange(5) < 4)) == []
