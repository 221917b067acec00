import numpy as np
import pytest

from dgc_pose.estimation import EstimationOptions, poselib_calls
from dgc_pose.estimation.poselib_calls import run_seeds, sampled_models
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from two_view import two_view_scene


def test_every_run_has_a_seed_of_its_own_that_depends_on_the_options_seed():
    seeds = run_seeds(EstimationOptions(runs=50))
    assert len(set(seeds)) == 50
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert seeds == run_seeds(EstimationOptions(runs=50))
    assert not set(seeds) & set(run_seeds(EstimationOptions(runs=50, seed=1)))
    assert run_seeds(EstimationOptions(runs=5)) == seeds[:5]


def test_of_all_runs_the_one_with_most_inliers_is_kept(monkeypatch):
    scene = two_view_scene(count=100, sigma_px=0.0, outliers=0.3)
    problem = scene.problem()
    truth = essential_from_pose(scene.R, scene.t)
    wrong = essential_from_pose(np.eye(3), np.array([0.0, 1, 0]))
    options = EstimationOptions(iterations=77)
    seeds = run_seeds(options)
    answers = dict(zip(seeds, [None, wrong, truth, wrong, None], strict=True))
    asked = []

    def answer(points1, points2, *, threshold, iterations, seed):
        asked.append((threshold, iterations, seed))
        return answers[seed]

    monkeypatch.setattr(poselib_calls, "essential_matrix", answer)
    model = sampled_models(problem, options)[0]
    assert sorted(asked) == [(problem.threshold, 77, seed) for seed in sorted(seeds)]
    assert rotation_error_deg(model.R, scene.R) < 1e-5
    assert translation_error_deg(model.t, scene.t) < 1e-5
    assert model.inliers[scene.true].all()


def test_each_run_samples_from_its_own_draw_and_its_model_is_scored_on_all(monkeypatch):
    scene = two_view_scene(count=300, sigma_px=0.0, outliers=0.3)
    problem = scene.problem()
    truth = essential_from_pose(scene.R, scene.t)
    pairs = np.column_stack([problem.points1, problem.points2])
    rows = {tuple(row): k for k, row in enumerate(pairs)}
    seen = {}

    def answer(points1, points2, *, threshold, iterations, seed):
        seen[seed] = [rows[tuple(row)] for row in np.column_stack([points1, points2])]
        return truth

    monkeypatch.setattr(poselib_calls, "essential_matrix", answer)
    monkeypatch.setattr(poselib_calls, "MAX_SAMPLED", 120)
    options = EstimationOptions()
    model = sampled_models(problem, options)[0]
    assert [len(set(drawn)) for drawn in seen.values()] == [120] * 5
    assert len({tuple(sorted(drawn)) for drawn in seen.values()}) == 5
    assert model.inliers.shape == (300,) and model.inliers[scene.true].all()
    again = seen.copy()
    seen.clear()
    sampled_models(problem, options)
    assert seen == again
    seen.clear()
    monkeypatch.setattr(poselib_calls, "MAX_SAMPLED", 300)
    sampled_models(problem, options)
    assert list(seen.values()) == [list(range(300))] * 5


def test_no_run_with_a_model_is_no_model(monkeypatch):
    monkeypatch.setattr(poselib_calls, "essential_matrix", lambda *a, **k: None)
    assert sampled_models(two_view_scene(count=100).problem(), EstimationOptions()) == []


@pytest.mark.parametrize("count", [0, 1, 4])
def test_fewer_than_five_matches_are_no_model(count):
    problem = two_view_scene(count=5).problem().subset(np.arange(5) < count)
    assert len(problem) == count
    assert sampled_models(problem, EstimationOptions()) == []
