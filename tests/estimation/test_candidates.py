"""Hypotheses that compete: of repeated structure, of mirrored depth; their likelihoods
and shares."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import camera_scene, joined, pinhole, two_view_scene
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from dgc_pose.cameras.prior import auto_camera
from dgc_pose.estimation import EstimationOptions, Hypothesis, estimate_pose
from dgc_pose.estimation.candidates import compared, ranked
from dgc_pose.estimation.probability import choice_shares, utility
from dgc_pose.geometry.epipolar import depths, sampson_distance
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.metrics import rotation_error_deg

AS_THEY_ARE = EstimationOptions(refine=False)
OPTIONS = EstimationOptions(runs=3, iterations=300, min_probability=None)
WEIGHTS = {"likelihood": 0.5, "map_agreement": 4.0, "lapse": 0.0}


def test_structure_one_period_off_gives_a_second_pose() -> None:
    """Four matches in ten agree on another motion: those of windows taken for their neighbours."""
    right = two_view_scene("general", seed=1, count=600, outliers=0.0, rotation_deg=10)
    wrong = two_view_scene("general", seed=5, count=450, outliers=0.0, rotation_deg=25)
    anywhere = two_view_scene("random", count=100)
    both = joined(right, wrong.points1, wrong.points2)
    both = joined(both, anywhere.points1, anywhere.points2)
    pose = estimate_pose(both.matches, *both.cameras, OPTIONS)
    assert pose.status == "ambiguous" and pose.R is None
    first, second = pose.alternatives
    assert max(right.errors_deg(first)) < 2 and first.num_inliers >= 560
    assert max(wrong.errors_deg(second)) < 3 and second.num_inliers >= 400
    assert f"{first.num_inliers} inliers fit a motion" in pose.reason


@pytest.mark.parametrize("seed", range(2))
def test_a_relief_seen_from_afar_can_be_turned_inside_out(seed: int) -> None:
    """Perspective, which tells the two apart, is within the error that the matches expect."""
    camera, turn = pinhole(17000, (1352, 901)), np.radians(12)
    picture = auto_camera(Header("JPEG", camera.size, Exif(focal_35mm=453)))
    camera = dataclasses.replace(camera, picture=picture)  # EXIF data of a telescope, too
    orbit = {"turn_deg": (0, 12, 0), "centre": (45 * np.sin(turn), 0, 45 * (1 - np.cos(turn)))}
    noise = {"count": 400, "sigma_px": 0.3, "outliers": 0.0, "seed": seed}
    scene = camera_scene(camera, camera, depths=(44.6, 45.4), **orbit, **noise)
    matches = dataclasses.replace(scene.matches, error_px=1.5)
    pose = estimate_pose(matches, camera, camera, OPTIONS)
    (other,) = pose.alternatives
    assert pose.success and other.num_inliers > 340
    assert rotation_error_deg(pose.R, scene.R) < 1
    # The same rotation the other way round.
    assert rotation_error_deg(other.R, scene.R.T) < 4 < 20 < rotation_error_deg(other.R, scene.R)


def _valued(likelihood: float, agreement: float | None = None, likely: bool = True) -> Hypothesis:
    true = np.ones(1, bool)
    return Hypothesis(np.eye(3), np.array([0, 0, 1.0]), true, true, likely, likelihood, agreement)


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


def test_likelihood_and_agreement_are_those_of_a_sum_over_the_matches() -> None:
    scene = two_view_scene("general", count=150)
    problem = dataclasses.replace(scene.problem(), options=AS_THEY_ARE)
    points, width = (problem.points1, problem.points2), problem.threshold
    first = Hypothesis.of_pose(problem, scene.R, scene.t)
    # The reversed translation has all inliers, behind the cameras.
    turned = Rotation.from_euler("z", 20, degrees=True).as_matrix() @ scene.t
    others = [Hypothesis.of_pose(problem, scene.R, t) for t in (turned, -scene.t)]
    weight = np.random.default_rng(0).random(150)
    matches = dataclasses.replace(problem.matches, confidence=weight)
    near = sampson_distance(*points, first.E)
    scale = 2.385 * 1.4826 * np.median(near[near < width])
    assert 0.02 * width < scale < width  # the limits play no part
    sample = dataclasses.replace(problem, matches=matches)
    for pose in compared(problem, first, others, sample):
        error = sampson_distance(*points, pose.E)
        in_front = (np.array(depths(*points, pose.R, pose.t)) > 0).all(0)
        costs = np.where(in_front, np.minimum(error, 3 * width), 3 * width) / scale
        likelihood = -np.log(1 + costs**2).sum() / math.sqrt(first.num_in_front)
        assert pose.likelihood == pytest.approx(likelihood)
        agreeing = (weight**2)[error < width].sum() / (weight**2).sum()
        assert pose.map_agreement == pytest.approx(agreeing)


@pytest.mark.parametrize(("count", "likely"), [(75, True), (74, False)])
def test_a_hypothesis_is_likely_from_three_quarters_of_the_inliers(count, likely) -> None:
    scene = two_view_scene("general", count=200)
    problem = dataclasses.replace(scene.problem(), options=AS_THEY_ARE)
    pose = Hypothesis.of_pose(problem, scene.R, scene.t)
    front = pose.inliers_in_front
    first, other = (
        dataclasses.replace(pose, inliers=front & (front.cumsum() <= n)) for n in (100, count)
    )
    answers = compared(problem, first, [other], None)
    assert [answer.likely for answer in answers] == [True, likely]
