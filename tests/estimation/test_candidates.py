"""Hypotheses that compete: of a plane, of repeated structure, of mirrored depth; their likelihoods
and shares."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import poster_scene, two_view_scene
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, Hypothesis, estimate_pose
from dgc_pose.estimation.candidates import compared, ranked
from dgc_pose.estimation.probability import choice_shares, utility
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

# Of two poses that explain a plane equally well none has a probability above one half.
OPTIONS = EstimationOptions(runs=3, iterations=300, min_probability=None)
WEIGHTS = {"likelihood": 0.5, "map_agreement": 4.0, "lapse": 0.0}


def _off(R: np.ndarray, t: np.ndarray, scene) -> float:
    return max(rotation_error_deg(R, scene.R), translation_error_deg(t, scene.t))


@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_a_plane_has_its_homography_s_other_pose(seed: int) -> None:
    scene = poster_scene(seed=seed)
    pose = estimate_pose(scene.matches, *scene.cameras, OPTIONS)
    assert pose.status == "planar" and len(pose.alternatives) in (1, 2)
    errors = [_off(answer.R, answer.t, scene) for answer in (pose, *pose.alternatives)]
    assert min(errors) < 3 and max(errors) > 10
    assert pose.alternatives[0].num_inliers > 0.75 * pose.num_inliers
    for words in ("other pose", "nearly a plane"):
        assert any(words in warning for warning in pose.warnings)


def test_structure_one_period_off_gives_a_second_pose() -> None:
    """Four matches in ten agree on another motion: those of windows taken for their neighbours."""
    right = two_view_scene("general", seed=1, count=600, outliers=0.0, rotation_deg=10)
    wrong = two_view_scene("general", seed=5, count=450, outliers=0.0, rotation_deg=25)
    rng = np.random.default_rng(0)
    noise1, noise2 = rng.random((100, 2)) * (1600, 1200), rng.random((100, 2)) * (1280, 960)
    points1 = np.vstack([right.points1, wrong.points1, noise1])
    points2 = np.vstack([right.points2, wrong.points2, noise2])
    matches = Matches(points1, points2, np.ones(len(points1)), 0.5)
    pose = estimate_pose(matches, *right.cameras, OPTIONS)
    assert pose.status == "ambiguous" and pose.R is None
    first, second = pose.alternatives
    assert _off(first.R, first.t, right) < 2 and first.num_inliers >= 560
    assert _off(second.R, second.t, wrong) < 3 and second.num_inliers >= 400
    assert f"{first.num_inliers} inliers agree on a motion" in pose.reason


@pytest.mark.parametrize("seed", range(4))
def test_a_relief_seen_from_afar_can_be_turned_inside_out(seed: int) -> None:
    """Perspective, which tells the two apart, is within the error that the matches expect."""
    rng = np.random.default_rng(seed)
    K = np.array([[20000.0, 0, 500], [0, 20000, 500], [0, 0, 1]])
    X = np.column_stack([rng.uniform(-1, 1, (400, 2)), rng.uniform(-0.4, 0.4, 400)])
    R = Rotation.from_rotvec(np.radians(12) * np.array([0.2, 0.97, 0.1])).as_matrix()
    middle = np.array([0, 0, 45.0])
    seen = []
    for rotation in (np.eye(3), R):
        local = X @ rotation.T + middle
        pixels = (local @ K.T)[:, :2] / local[:, 2:]
        seen.append(pixels + 0.3 * rng.standard_normal(pixels.shape))
    camera = Camera(K, (1001, 1001))
    pose = estimate_pose(Matches(*seen, np.ones(400), 1.5), camera, camera, OPTIONS)
    (other,) = pose.alternatives
    assert pose.success and other.num_inliers > 390
    assert rotation_error_deg(pose.R, R) < 1
    # The same rotation the other way round.
    assert rotation_error_deg(other.R, R.T) < 4 < 20 < rotation_error_deg(other.R, R)


def _turned(scene, problem, degrees: float = 20.0) -> Hypothesis:
    """The true pose with its translation turned in the plane of its first two coordinates."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return Hypothesis.of_pose(problem, scene.R, turn @ scene.t)


def _valued(likelihood: float, agreement: float | None = None, likely: bool = True) -> Hypothesis:
    true = np.ones(1, bool)
    return Hypothesis(np.eye(3), np.array([0, 0, 1.0]), true, true, likely, likelihood, agreement)


def _as_they_are(problem: TwoViewProblem) -> TwoViewProblem:
    return dataclasses.replace(problem, options=EstimationOptions(refine=False))


def _error(u: np.ndarray, v: np.ndarray, E: np.ndarray) -> float:
    """The Sampson distance of one match."""
    line2, line1 = E @ (*u, 1), E.T @ (*v, 1)
    return abs(np.dot((*v, 1), line2)) / math.sqrt(sum(line2[:2] ** 2) + sum(line1[:2] ** 2))


def _depths(u: np.ndarray, v: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The depths at which the rays of one match come nearest to each other."""
    rays = np.column_stack([R @ (*u, 1), -np.array([*v, 1])])
    return np.linalg.lstsq(rays, -t, rcond=None)[0]


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=6))
def test_shares_are_scipy_s_softmax(utilities) -> None:
    shares = softmax(utilities)
    np.testing.assert_allclose(choice_shares(utilities, 0.0), shares, rtol=1e-9, atol=1e-300)
    lapsed = 0.9 * np.append(shares, 0) + 0.1 / len(shares) * np.append(np.ones(len(shares)), 0)
    np.testing.assert_allclose(choice_shares([*utilities, -math.inf], 0.1), lapsed, rtol=1e-9)


def test_the_likeliest_is_the_first_and_an_unlikely_one_has_no_share() -> None:
    among = [_valued(-8.0, 0.5), _valued(-1.0, 1.0, likely=False), _valued(-6.0, 0.75)]
    first, second, third = ranked(among, WEIGHTS)
    # Utilities of the likely ones: -4 + 2 = -2 and -3 + 3 = 0.
    assert (first.likelihood, second.likelihood, third.likelihood) == (-6.0, -8.0, -1.0)
    assert first.share == pytest.approx(1 / (1 + math.exp(-2)))
    assert first.share + second.share == pytest.approx(1) and third.share == 0
    assert utility(-6.0, None, WEIGHTS) == -3.0
    assert [pose.likelihood for pose in ranked(among, None)] == [-8.0, -1.0, -6.0]


@pytest.mark.parametrize("seed", range(3))
def test_likelihood_and_agreement_are_those_of_a_loop_over_the_matches(seed: int) -> None:
    scene = two_view_scene("general", seed=seed, count=150)
    problem = scene.problem()
    first = Hypothesis.of_pose(problem, scene.R, scene.t)
    # The reversed translation has all inliers, behind the cameras.
    others = [_turned(scene, problem), Hypothesis.of_pose(problem, scene.R, -scene.t)]
    matchability = np.random.default_rng(0).random(150)
    matches = dataclasses.replace(problem.matches, confidence=matchability)
    sample = dataclasses.replace(problem, matches=matches)
    rows = list(zip(problem.points1, problem.points2, matchability, strict=True))
    near = [e for u, v, _ in rows if (e := _error(u, v, first.E)) < problem.threshold]
    scale = 2.385 * 1.4826 * np.median(near)
    assert 0.02 * problem.threshold < scale < problem.threshold  # the limits play no part
    limit, root = 3 * problem.threshold, math.sqrt(first.num_in_front)
    for pose in compared(_as_they_are(problem), first, others, sample):
        total = agreeing = 0.0
        for u, v, weight in rows:
            error = _error(u, v, pose.E)
            agreeing += weight**2 * (error < problem.threshold)
            in_front = (_depths(u, v, pose.R, pose.t) > 0).all()
            total -= math.log(1 + ((min(error, limit) if in_front else limit) / scale) ** 2)
        assert pose.likelihood == pytest.approx(total / root)
        assert pose.map_agreement == pytest.approx(agreeing / sum(matchability**2))


@pytest.mark.parametrize(("count", "likely"), [(75, True), (74, False)])
def test_a_hypothesis_is_likely_from_three_quarters_of_the_inliers(
    count: int, likely: bool
) -> None:
    scene = two_view_scene("general", count=200)
    problem = scene.problem()
    pose = Hypothesis.of_pose(problem, scene.R, scene.t)
    front = pose.inliers_in_front
    first, other = (
        dataclasses.replace(pose, inliers=front & (front.cumsum() <= n)) for n in (100, count)
    )
    answers = compared(_as_they_are(problem), first, [other], None)
    assert [answer.likely for answer in answers] == [True, likely]
