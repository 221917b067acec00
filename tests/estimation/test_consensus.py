from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.estimation import EstimationOptions, consensus
from dgc_pose.estimation.consensus import (
    best_model,
    best_planar_model,
    error_scale,
    model_of_essential,
    model_of_pose,
    planar_share,
    polished,
    refined,
    run_seeds,
)
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.geometry.homography import fit_homography
from dgc_pose.metrics.pose import rotation_error_deg, translation_error_deg
from two_view import two_view_scene

THRESHOLD = 2e-3


def normalised(kind="general", **settings):
    scene = two_view_scene(kind, **settings)
    camera1, camera2 = scene.cameras
    return scene, camera1.normalise(scene.points1), camera2.normalise(scene.points2)


def test_every_run_has_a_seed_of_its_own_that_depends_on_the_options_seed():
    seeds = run_seeds(EstimationOptions(runs=50))
    assert len(set(seeds)) == 50
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert seeds == run_seeds(EstimationOptions(runs=50))
    assert not set(seeds) & set(run_seeds(EstimationOptions(runs=50, seed=1)))
    assert run_seeds(EstimationOptions(runs=5)) == seeds[:5]


def test_of_all_runs_the_one_with_most_inliers_is_kept(monkeypatch):
    scene, points1, points2 = normalised(count=100, sigma_px=0.0, outliers=0.3)
    truth = essential_from_pose(scene.R, scene.t)
    wrong = essential_from_pose(np.eye(3), np.array([0.0, 1, 0]))
    answers = iter([[], [wrong], [wrong, truth], [wrong], []])
    asked = []

    def backend(first, second, *, threshold, iterations, seed):
        asked.append((threshold, iterations, seed))
        return next(answers)

    monkeypatch.setattr(consensus, "get_backend", lambda name: backend)
    options = EstimationOptions(estimator="opencv", refine=False, iterations=77)
    model = best_model(points1, points2, THRESHOLD, options)
    assert asked == [(THRESHOLD, 77, seed) for seed in run_seeds(options)]
    assert rotation_error_deg(model.R, scene.R) < 1e-5
    assert translation_error_deg(model.t, scene.t) < 1e-5
    assert model.inliers[scene.true].all()


def test_each_run_sees_a_draw_of_its_own_and_its_model_is_scored_on_all(monkeypatch):
    scene, points1, points2 = normalised(count=300, sigma_px=0.0, outliers=0.3)
    truth = essential_from_pose(scene.R, scene.t)
    rows = {tuple(row): k for k, row in enumerate(np.column_stack([points1, points2]))}
    seen = []

    def backend(first, second, *, threshold, iterations, seed):
        seen.append([rows[tuple(row)] for row in np.column_stack([first, second])])
        return [truth]

    monkeypatch.setattr(consensus, "get_backend", lambda name: backend)
    options = EstimationOptions(estimator="opencv", refine=False, max_sampled=120)
    model = best_model(points1, points2, THRESHOLD, options)
    assert [len(set(drawn)) for drawn in seen] == [120] * 5
    assert len({tuple(sorted(drawn)) for drawn in seen}) == 5
    assert model.inliers.shape == (300,) and model.inliers[scene.true].all()
    again = seen.copy()
    seen.clear()
    best_model(points1, points2, THRESHOLD, options)
    assert seen == again
    seen.clear()
    best_model(points1, points2, THRESHOLD, replace(options, max_sampled=300))
    assert seen == [list(range(300))] * 5


def test_no_run_with_a_model_is_no_model(monkeypatch):
    _, points1, points2 = normalised(count=100)
    monkeypatch.setattr(consensus, "get_backend", lambda name: lambda *a, **k: [])
    assert best_model(points1, points2, THRESHOLD, EstimationOptions()) is None


@pytest.mark.parametrize("count", [0, 1, 4])
def test_fewer_than_five_matches_are_no_model(count):
    _, points1, points2 = normalised(count=5)
    assert best_model(points1[:count], points2[:count], THRESHOLD, EstimationOptions()) is None


def test_of_four_poses_the_one_with_points_in_front_is_chosen():
    for seed in range(5):
        scene, points1, points2 = normalised(seed=seed, count=60, sigma_px=0.0, outliers=0.0)
        E = essential_from_pose(scene.R, scene.t)
        for scale in (1.0, -2.0):
            model = model_of_essential(points1, points2, scale * E, THRESHOLD)
            assert np.abs(model.R - scene.R).max() < 1e-6
            assert np.abs(model.t - scene.t).max() < 1e-6
            assert model.in_front.all()


def test_the_inliers_are_those_below_the_threshold():
    scene, points1, points2 = normalised(count=200, sigma_px=1.0)
    model = model_of_pose(points1, points2, scene.R, scene.t, THRESHOLD)
    distance = sampson_distance(points1, points2, essential_from_pose(scene.R, scene.t))
    assert np.array_equal(model.inliers, distance < THRESHOLD)
    assert model.count == (distance < THRESHOLD).sum()


def test_refinement_brings_a_rough_pose_to_the_truth():
    scene, points1, points2 = normalised(count=600, sigma_px=0.3, outliers=0.3)
    rough = scene.t + (0.02, 0.02, -0.02)
    rough /= np.linalg.norm(rough)
    before = model_of_pose(points1, points2, scene.R, rough, 5e-3)
    after = refined(points1, points2, before, 5e-3)
    assert after.inliers[scene.true].all()
    assert translation_error_deg(after.t, scene.t) < 0.2 * translation_error_deg(rough, scene.t)


def test_refinement_does_not_lose_inliers():
    for seed in range(4):
        _, points1, points2 = normalised(seed=seed, count=150, sigma_px=2.0, outliers=0.6)
        plain = best_model(points1, points2, THRESHOLD, EstimationOptions(refine=False, runs=2))
        fine = best_model(points1, points2, THRESHOLD, EstimationOptions(refine=True, runs=2))
        assert fine.count >= 0.94 * plain.count


def test_polishing_does_not_let_poor_inliers_pull_the_pose():
    """Most inliers are ten times better than the threshold, and one in five lies anywhere in it."""
    gains = []
    for seed in range(5):
        scene, points1, points2 = normalised(seed=seed, count=600, sigma_px=0.2, outliers=0.0)
        rng = np.random.default_rng(seed)
        poor = rng.random(600) < 0.2
        points2[poor] += rng.uniform(0, THRESHOLD, (poor.sum(), 2))  # all to one side
        before = refined(
            points1, points2, model_of_pose(points1, points2, scene.R, scene.t, 2e-3), 2e-3
        )
        after = polished(points1, points2, before, 2e-3)
        assert after.count >= 0.98 * before.count
        gains.append(
            [
                max(rotation_error_deg(m.R, scene.R), translation_error_deg(m.t, scene.t))
                for m in (before, after)
            ]
        )
    worse, better = np.mean(gains, axis=0)
    assert better < 0.6 * worse


def test_polishing_leaves_what_too_few_inliers_say():
    scene, points1, points2 = normalised(count=100, outliers=0.0)
    model = model_of_pose(points1[:5], points2[:5], scene.R, scene.t, THRESHOLD)
    assert polished(points1[:5], points2[:5], model, THRESHOLD) is model


def test_the_scale_follows_the_errors_between_a_floor_and_the_threshold():
    for sigma_px, expected in ((0.0, 0.02 * THRESHOLD), (30.0, THRESHOLD)):
        scene, points1, points2 = normalised(count=300, sigma_px=sigma_px, outliers=0.0)
        assert error_scale(points1, points2, scene.R, scene.t, THRESHOLD) == expected
    scene, points1, points2 = normalised(count=4000, sigma_px=0.5, outliers=0.0)
    error = sampson_distance(points1, points2, essential_from_pose(scene.R, scene.t))
    # Gaussian errors: 2.385 of their standard deviations (Rey 1983).
    scale = error_scale(points1, points2, scene.R, scene.t, THRESHOLD)
    assert scale == pytest.approx(2.385 * np.sqrt((error**2).mean()), rel=0.05)


def test_one_homography_explains_a_plane_and_not_a_solid():
    for kind, low, high in (("planar", 0.9, 1.0), ("general", 0.0, 0.5)):
        scene, points1, points2 = normalised(kind, count=500, sigma_px=0.5, outliers=0.4)
        model = model_of_pose(points1, points2, scene.R, scene.t, THRESHOLD)
        share, H = planar_share(points1, points2, model, THRESHOLD, seed=0)
        assert low <= share <= high
        assert H is not None


def test_a_plane_brings_a_wrong_pose_back_to_a_right_one():
    scene, points1, points2 = normalised("planar", count=500, sigma_px=0.2, outliers=0.3)
    H = fit_homography(points1[scene.true], points2[scene.true], THRESHOLD)
    wrong = model_of_pose(points1, points2, np.eye(3), np.array([0.0, 0, 1]), THRESHOLD)
    for refine in (False, True):
        model = best_planar_model(points1, points2, wrong, H, THRESHOLD, refine)
        assert rotation_error_deg(model.R, scene.R) < 1
        assert translation_error_deg(model.t, scene.t) < 2
