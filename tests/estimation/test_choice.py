"""Which of several poses is the right one: likelihoods, shares and their order."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax

from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.choice import (
    CHOICE_FEATURES,
    Hypothesis,
    choice_shares,
    hypotheses,
    ranked,
    utility,
)
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.refine import planar_models, planar_share, refit
from two_view import poster_scene, two_view_scene

AS_THEY_ARE = EstimationOptions(refine=False)
WEIGHTS = {"likelihood": 0.5, "map_agreement": 4.0}


def _turned(scene, problem, degrees: float = 20.0) -> Model:
    """The true pose with its translation turned in the plane of its first two coordinates."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return Model.of_pose(problem, scene.R, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ scene.t)


def _hypothesis(likelihood: float, agreement: float | None = None, likely: bool = True):
    model = Model(np.eye(3), np.array([0, 0, 1.0]), np.ones(1, bool), np.ones(1, bool))
    return Hypothesis(model, likely, likelihood, agreement)


def _error(u: np.ndarray, v: np.ndarray, E: np.ndarray) -> float:
    """The Sampson distance of one match."""
    line2, line1 = E @ (*u, 1), E.T @ (*v, 1)
    return abs(np.dot((*v, 1), line2)) / math.sqrt(sum(line2[:2] ** 2) + sum(line1[:2] ** 2))


def _depths(u: np.ndarray, v: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Those at which the rays of one match come nearest to each other."""
    rays = np.column_stack([R @ (*u, 1), -np.array([*v, 1])])
    return np.linalg.lstsq(rays, -t, rcond=None)[0]


def test_shares_are_the_odds_over_their_sum() -> None:
    # exp of 0, ln 2 and ln 5 is 1, 2 and 5.
    assert choice_shares([0.0, math.log(2), math.log(5)]) == pytest.approx([1 / 8, 2 / 8, 5 / 8])
    assert choice_shares([-3.0]) == [1.0]


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=6))
def test_shares_are_scipy_s_softmax(utilities) -> None:
    shares = choice_shares(utilities)
    np.testing.assert_allclose(shares, softmax(utilities), rtol=1e-9, atol=1e-300)
    assert shares.sum() == pytest.approx(1)


def test_a_utility_is_the_weighted_sum_of_likelihood_and_agreement() -> None:
    assert set(WEIGHTS) == set(CHOICE_FEATURES)
    assert utility(_hypothesis(-6.0, 0.25), WEIGHTS) == pytest.approx(-6 * 0.5 + 0.25 * 4)
    assert utility(_hypothesis(-6.0, None), WEIGHTS) == pytest.approx(-6 * 0.5)
    assert utility(_hypothesis(-6.0, 0.25), {"likelihood": 2.0}) == pytest.approx(-12)


def test_the_likeliest_is_the_first_and_an_unlikely_one_has_no_share() -> None:
    among = [_hypothesis(-8.0, 0.5), _hypothesis(-1.0, 1.0, likely=False), _hypothesis(-6.0, 0.75)]
    first, second, third = ranked(among, WEIGHTS)
    # Utilities of the likely ones: -4 + 2 = -2 and -3 + 3 = 0.
    assert (first.likelihood, second.likelihood, third.likelihood) == (-6.0, -8.0, -1.0)
    assert first.share == pytest.approx(1 / (1 + math.exp(-2)))
    assert first.share + second.share == pytest.approx(1) and third.share == 0


def test_without_weights_the_order_stays_and_nothing_has_a_share() -> None:
    among = [_hypothesis(-8.0), _hypothesis(-1.0), _hypothesis(-6.0, likely=False)]
    kept = ranked(among, None)
    assert all(a is b for a, b in zip(kept, among, strict=True))
    assert all(math.isnan(hypothesis.share) for hypothesis in kept)


@pytest.mark.parametrize("seed", range(3))
def test_a_likelihood_is_that_of_a_loop_over_the_matches(seed: int) -> None:
    scene = two_view_scene("general", seed=seed, count=150)
    problem = scene.problem()
    first = Model.of_pose(problem, scene.R, scene.t)
    # The reversed translation has all inliers, behind the cameras.
    others = [_turned(scene, problem), Model.of_pose(problem, scene.R, -scene.t)]
    errors = [_error(u, v, first.E) for u, v in zip(problem.points1, problem.points2, strict=True)]
    near = [error for error in errors if error < problem.threshold]
    scale = 2.385 * 1.4826 * np.median(near)
    assert 0.02 * problem.threshold < scale < problem.threshold  # the limits play no part
    front = 0
    for model, answer in zip(
        (first, *others), hypotheses(problem, first, others, None, AS_THEY_ARE), strict=True
    ):
        total = 0.0
        for u, v in zip(problem.points1, problem.points2, strict=True):
            error, limit = _error(u, v, model.E), 3 * problem.threshold
            in_front = (_depths(u, v, model.R, model.t) > 0).all()
            if model is first and in_front and error < problem.threshold:
                front += 1
            error = min(error, limit) if in_front else limit
            total -= math.log(1 + (error / scale) ** 2)
        assert answer.model is model and answer.map_agreement is None
        assert answer.likelihood == pytest.approx(total / math.sqrt(front))


def test_the_map_s_agreement_is_a_share_by_the_square_of_the_matchability() -> None:
    scene = two_view_scene("general", count=200)
    problem = scene.problem()
    matchability = np.random.default_rng(0).random(200)
    sample = dataclasses.replace(problem, confidence=matchability)
    first = Model.of_pose(problem, scene.R, scene.t)
    others = [_turned(scene, problem)]
    for answer in hypotheses(problem, first, others, sample, AS_THEY_ARE):
        near, total = 0.0, 0.0
        for u, v, weight in zip(problem.points1, problem.points2, matchability, strict=True):
            near += weight**2 * (_error(u, v, answer.model.E) < problem.threshold)
            total += weight**2
        assert answer.map_agreement == pytest.approx(near / total)


@pytest.mark.parametrize("relief", [0.02, 0.2])
def test_which_is_likelier_does_not_depend_on_the_order(relief: float) -> None:
    scene = poster_scene(relief=relief)
    problem = scene.problem(threshold=1e-3)
    models = [Model.of_pose(problem, scene.R, scene.t), _turned(scene, problem, 8.0)]
    forth = hypotheses(problem, models[0], models[1:], None, AS_THEY_ARE)
    back = hypotheses(problem, models[1], models[:1], None, AS_THEY_ARE)
    assert forth[0].likelihood > forth[1].likelihood
    assert back[1].likelihood > back[0].likelihood


@pytest.mark.parametrize(("count", "likely"), [(75, True), (74, False)])
def test_a_hypothesis_is_likely_from_three_quarters_of_the_inliers(
    count: int, likely: bool
) -> None:
    scene = two_view_scene("general", count=200)
    problem = scene.problem()
    model = Model.of_pose(problem, scene.R, scene.t)
    front = model.inliers_in_front
    first, other = (
        dataclasses.replace(model, inliers=front & (front.cumsum() <= n)) for n in (100, count)
    )
    assert (first.count_in_front, other.count_in_front) == (100, count)
    answers = hypotheses(problem, first, [other], None, AS_THEY_ARE)
    assert [answer.likely for answer in answers] == [True, likely]


def test_a_likely_hypothesis_is_fitted_once_more_and_only_that() -> None:
    scene = poster_scene(seed=2)
    problem = scene.problem(threshold=1e-3)
    first = Model.of_pose(problem, scene.R, scene.t)
    share, H = planar_share(problem, first)
    assert share > 0.9
    other = max(
        planar_models(problem, H),
        key=lambda model: (model.angle_to(scene.R, scene.t) > 20, model.count),
    )
    unlikely = _turned(scene, problem, 60.0)
    answers = hypotheses(problem, first, [other, unlikely], None, EstimationOptions())
    fitted = refit(problem, other, adapt_scale=True)
    assert fitted is not other and [answer.likely for answer in answers] == [True, True, False]
    assert answers[0].model is first and answers[2].model is unlikely
    assert np.array_equal(answers[1].model.R, fitted.R)
    assert np.array_equal(answers[1].model.t, fitted.t)
