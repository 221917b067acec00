"""Pairs that two poses explain: of a plane, and of a plane that may have moved."""

import dataclasses

import numpy as np
import pytest
from scenes import SCENE_KINDS, SIZE1, SIZE2, TwoViewScene, poster_scene, two_view_scene

from dgc_pose.estimation import EstimationOptions, RelativePose, candidates, estimate_pose
from dgc_pose.estimation.probability import ErrorModel, FittedModels, ProbabilityModel, SamePlace
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg

WEIGHTS = "net"  # fingerprint of a network whose matches the models are of
SEEDS = (2, 3)  # all points in front of the cameras in both poses
AS_STATED = ErrorModel(0.0, 0.0)
ANY = 1 / (1 + np.exp(-3.0))  # probability that a right pose is among the hypotheses


@pytest.fixture
def known_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models of the probability with weights that no fit changes: 95 % for any evidence, and the
    choice by the likelihood."""
    choice, certain = {"likelihood": 1.0, "lapse": 0.0}, SamePlace(0.0, 30.0)
    model = ProbabilityModel({}, 3.0, {}, AS_STATED, AS_STATED, choice, certain)
    kinds = ("matches", "network", "matches_auto", "network_auto")
    models = FittedModels(dict.fromkeys(kinds, model), AS_STATED, frozenset({WEIGHTS}))
    monkeypatch.setattr(candidates, "shipped_models", lambda: models)


def _estimate(scene: TwoViewScene, min_probability: float | None = 0.5) -> RelativePose:
    options = EstimationOptions(runs=3, iterations=300, min_probability=min_probability)
    matches = dataclasses.replace(scene.matches, weights=WEIGHTS)
    return estimate_pose(matches, *scene.cameras, options)


@pytest.mark.usefixtures("known_models")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_plane_with_two_poses_is_ambiguous(seed: int) -> None:
    scene = poster_scene(seed=seed, sigma_px=0.1)
    pose = _estimate(scene)
    assert (pose.status, pose.success, pose.R, pose.t) == ("ambiguous", False, None, None)
    assert pose.covariance is None and pose.camera1 is None and pose.cam2_from_cam1 is None
    assert pose.probability == 0
    first, second = pose.alternatives
    assert first.probability >= second.probability > 0.2 * ANY  # 1 - `MIN_SHARE`
    near, far = sorted(max(scene.errors_deg(other)) for other in pose.alternatives)
    assert near < 1 and far > 10
    assert first.probability + second.probability == pytest.approx(ANY)
    assert pose.any_probability == pytest.approx(ANY)
    assert pose.reason == (
        "two poses explain the matches: probabilities "
        f"{100 * first.probability:.0f} % and {100 * second.probability:.0f} %"
    )
    assert not any("other pose" in warning for warning in pose.warnings)
    likeliest, *_ = pose.hypotheses
    assert np.array_equal(likeliest.R, first.R)
    assert np.array_equal(pose.inliers, likeliest.inliers)


@pytest.mark.usefixtures("known_models")
@pytest.mark.parametrize("seed", [6, 9])
def test_points_behind_a_camera_tell_the_two_poses_apart(seed: int) -> None:
    scene = poster_scene(seed=seed, sigma_px=0.1)
    pose = _estimate(scene)
    assert pose.status == "planar" and max(scene.errors_deg(pose)) < 1
    (other,) = pose.alternatives
    assert pose.probability > 0.9 * ANY > 0.1 * ANY > other.probability


@pytest.mark.parametrize("seed", [2, 4])
def test_without_a_probability_poses_keep_the_order_of_inliers(seed: int) -> None:
    """Those of another dense map than that of a network of the fit."""
    scene = poster_scene(seed=seed, sigma_px=0.4)
    pose = _estimate(scene, min_probability=None)
    assert pose.status == "planar" and len(pose.alternatives) in (1, 2)
    assert pose.probability is None and pose.any_probability is None
    assert all(np.isnan(hypothesis.share) for hypothesis in pose.hypotheses)
    for other in pose.alternatives:
        assert other.probability is None and other.num_inliers <= pose.num_inliers
    assert pose.alternatives[0].num_inliers > 0.75 * pose.num_inliers
    errors = [max(scene.errors_deg(answer)) for answer in (pose, *pose.alternatives)]
    assert min(errors) < 3 and max(errors) > 10
    for words in ("other pose", "nearly a plane"):
        assert any(words in warning for warning in pose.warnings)


@pytest.mark.usefixtures("known_models")
@pytest.mark.parametrize("kind", [*SCENE_KINDS, "poster"])
def test_the_probabilities_of_one_pair_add_up_to_one_at_most(kind) -> None:
    scene = poster_scene() if kind == "poster" else two_view_scene(kind, count=300)
    pose = _estimate(scene)
    assert 0 <= pose.probability <= 1
    for first, *others in [pose.hypotheses] if pose.hypotheses else []:
        assert not pose.success or np.array_equal(first.R, pose.R)
        assert not any(other.is_among([first]) for other in others)
    assert all(0 <= other.probability <= 1 for other in pose.alternatives)
    total = pose.probability + sum(other.probability for other in pose.alternatives)
    if pose.success or pose.status == "ambiguous":
        assert pose.any_probability == pytest.approx(total)
    else:
        assert not pose.alternatives and not any("other pose" in text for text in pose.warnings)
    assert total <= 1 and 0 <= pose.any_probability <= 1
    if pose.hypotheses:
        assert sum(hypothesis.share for hypothesis in pose.hypotheses) == pytest.approx(1)


def _pose_of(*scenes: TwoViewScene, key_points: bool = False) -> RelativePose:
    points1, points2 = (
        np.concatenate([getattr(scene, name) for scene in scenes])
        for name in ("points1", "points2")
    )
    matches = Matches(points1, points2, np.ones(len(points1)), 0.5, key_points, WEIGHTS)
    return estimate_pose(matches, *scenes[0].cameras)


@pytest.mark.parametrize(("seed", "key_points"), [(0, True), (1, False), (2, False)])
def test_a_plane_that_may_have_moved_is_ambiguous(seed: int, key_points: bool) -> None:
    """A plane over most of the image, before a scene that the camera moved past."""
    plane = two_view_scene("planar", seed=seed, count=700, outliers=0.0, rotation_deg=15)
    scene = two_view_scene("general", seed=seed + 9, count=250, outliers=0.1, rotation_deg=25)
    pose = _pose_of(plane, scene, key_points=key_points)
    assert pose.status == "ambiguous" and pose.R is None and "another motion" in pose.reason
    assert min(max(scene.errors_deg(other)) for other in pose.alternatives) < 2
    for other in pose.alternatives:
        assert other.inliers.shape == other.in_front.shape == (pose.num_matches,)


@pytest.mark.parametrize(("around", "status"), [(0, "planar"), (8, "planar"), (40, "ambiguous")])
def test_a_plane_amid_matches_that_contradict_it_may_have_moved(around: int, status: str) -> None:
    """A board held before a scene, whose matches are too few and too wrong for a motion."""
    plane = two_view_scene("planar", count=2500, outliers=0.0, rotation_deg=15)
    (width1, height1), (width2, height2) = SIZE1, SIZE2
    held = (np.abs(plane.points1 / SIZE1 - 0.5) < 0.25).all(1)
    rng = np.random.default_rng(1)
    edge1, edge2 = (
        np.column_stack([rng.uniform(0, width, around), rng.choice([0.02, 0.98], around) * height])
        for width, height in ((width1, height1), (width2, height2))
    )
    points1 = np.vstack([plane.points1[held], edge1])
    points2 = np.vstack([plane.points2[held], edge2])
    matches = Matches(points1, points2, np.ones(len(points1)), 0.5, False, WEIGHTS)
    pose = estimate_pose(matches, *plane.cameras)
    assert pose.status == status, pose
    assert pose.success or "may have moved" in pose.reason


@pytest.mark.usefixtures("known_models")
@pytest.mark.parametrize("seed", SEEDS)
def test_the_likeliest_pose_of_a_moved_plane_with_two_poses_comes_first(seed: int) -> None:
    """Half of the probability is that of the other motion."""
    plane = poster_scene(seed=seed, sigma_px=0.1)
    scene = two_view_scene("general", seed=seed + 9, count=120, outliers=0.0, rotation_deg=25)
    pose = _pose_of(plane, scene)
    assert pose.status == "ambiguous" and len(pose.alternatives) == 3, pose
    likely = [other.probability for other in pose.alternatives]
    assert likely == sorted(likely, reverse=True) and sum(likely) == pytest.approx(ANY)
    assert likely[0] == pytest.approx(ANY / 2) and likely[1] < likely[0]


@pytest.mark.parametrize("seed", range(2))
def test_wrong_matches_are_no_second_motion(seed: int) -> None:
    pose = _pose_of(two_view_scene("planar", seed=seed, outliers=0.4))
    assert pose.evidence is not None and pose.evidence.num_second_inliers == 0


def test_an_object_before_a_scene_with_depth_is_left_over() -> None:
    """The scene is no plane, so that its motion is the camera's."""
    scene = two_view_scene("general", count=700, outliers=0.0)
    pose = _pose_of(scene, two_view_scene("planar", seed=5, count=150, outliers=0.0))
    assert pose.status == "ok" and rotation_error_deg(pose.R, scene.R) < 0.5


@pytest.mark.parametrize(("share", "seed"), [(0.7, 0), (0.5, 1)])
def test_a_rotation_that_another_motion_contradicts_is_not_given_out(seed, share) -> None:
    """Matches of a camera that turned by 10 degrees, and others of one that turned by 25."""
    turned = two_view_scene(
        "rotation_only", seed=seed, count=round(800 * share), outliers=0.0, rotation_deg=10
    )
    scene = two_view_scene(
        "general", seed=seed + 9, count=round(800 * (1 - share)), outliers=0.0, rotation_deg=25
    )
    alone = _pose_of(turned)
    assert alone.status == "rotation_only" and rotation_error_deg(alone.R, turned.R) < 0.2
    pose = _pose_of(turned, scene)
    assert pose.status == "ambiguous" and pose.R is None and pose.camera1 is None
    for R in (scene.R, turned.R):
        assert min(rotation_error_deg(other.R, R) for other in pose.alternatives) < 1
