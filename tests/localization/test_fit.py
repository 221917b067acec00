"""The pose of a photograph by the matches of all references."""

from dataclasses import replace

import numpy as np
import poselib
import pytest
from world_scene import CAMERA, OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.estimation.covariance import error_radius, error_radius_deg
from dgc_pose.estimation.intrinsics_prior import IntrinsicsPrior, with_parameters
from dgc_pose.localization.correspondences import (
    PairCorrespondences,
    PointCorrespondences,
    WorldPose,
)
from dgc_pose.localization.fit import located, world_covariance
from dgc_pose.metrics import rotation_error_deg

EXACT = IntrinsicsPrior.of(CAMERA, PHOTO_CAMERA)


def _sights(scene: WorldScene, seed: int = 0) -> list[PairCorrespondences]:
    return [scene.sight(number, seed) for number in range(len(scene.references))]


def _errors(scene: WorldScene, pose: WorldPose) -> tuple[float, float]:
    distance = float(np.linalg.norm(pose.centre - scene.centre))
    return rotation_error_deg(pose.R, scene.R), distance


def test_the_pose_is_that_of_least_squares() -> None:
    """PoseLib's own refinement of the inliers, from the truth, is as far from the truth."""
    scene = world_scene()
    sights = _sights(scene)
    pose = located(sights, [], EXACT, OPTIONS)
    assert pose is not None
    assert max(_errors(scene, pose)) < 0.05
    camera = {"model": "SIMPLE_PINHOLE", "width": 2, "height": 2, "params": [1000.0, 0, 0]}
    matches, references = [], []
    for number, sight in enumerate(sights):
        kept = sight.hypothesis(scene.pose).inliers_in_front
        match = poselib.PairwiseMatches()
        match.cam_id1, match.cam_id2 = number, 0
        match.x1 = 1000 * sight.problem.points1[kept]
        match.x2 = 1000 * sight.problem.points2[kept]
        matches.append(match)
        reference = poselib.CameraPose()
        reference.R, reference.t = sight.R, -sight.R @ sight.centre
        references.append(reference)
    start = poselib.CameraPose()
    start.R, start.t = scene.R, -scene.R @ scene.centre
    theirs, _ = poselib.refine_generalized_relative_pose(
        matches, start, references, [camera] * len(sights), [poselib.CameraPose()], [camera]
    )
    assert rotation_error_deg(theirs.R, pose.R) < 0.03
    assert np.linalg.norm(-theirs.R.T @ theirs.t - pose.centre) < 0.01


def test_without_hypotheses_ransac_has_the_start() -> None:
    scene = world_scene()
    far = [replace(s.hypotheses[0], R=s.hypotheses[0].R.T) for s in _sights(scene)]
    sights = [replace(s, hypotheses=[h]) for s, h in zip(_sights(scene), far, strict=True)]
    pose = located(sights, [], EXACT, OPTIONS)
    assert pose is not None and max(_errors(scene, pose)) < 0.05
    again = located(sights, [], EXACT, OPTIONS)
    assert again is not None and np.array_equal(pose.centre, again.centre)


def test_a_focal_length_is_fitted() -> None:
    scene = world_scene()
    wrong = replace(PHOTO_CAMERA.with_focal(1.05 * PHOTO_CAMERA.focal), focal_std=0.1)
    sights = [scene.sight(number, photo=wrong) for number in range(5)]
    pose = located(sights, [], IntrinsicsPrior.of(CAMERA, wrong), OPTIONS)
    assert pose is not None
    fitted = with_parameters(wrong, pose.parameters)
    assert fitted.focal == pytest.approx(PHOTO_CAMERA.focal, rel=0.005)
    assert max(_errors(scene, pose)) < 0.1


def test_points_determine_the_distance_of_a_single_reference() -> None:
    scene = world_scene(np.array([[1.0, 0, 0]]))
    places = PHOTO_CAMERA.normalise(scene.pixels(PHOTO_CAMERA, scene.R, scene.centre))
    shown = PointCorrespondences(scene.points[:40], places[:40], None, 0.002)
    sights = _sights(scene)
    pose = located(sights, [shown], EXACT, OPTIONS)
    assert pose is not None and max(_errors(scene, pose)) < 0.02
    covariance = world_covariance([*sights, shown], pose, EXACT)
    assert covariance is not None and error_radius(covariance[3:, 3:]) < 0.05
    assert located(sights, [], EXACT, OPTIONS) is None


def test_expected_errors_hold() -> None:
    """The jackknife alone, without the factor for what references have of their own errors."""
    within = []
    for seed in range(40):
        scene = world_scene(seed=seed, count=150)
        sights = _sights(scene, seed)
        pose = located(sights, [], EXACT, OPTIONS)
        assert pose is not None
        covariance = world_covariance(sights, pose, EXACT)
        assert covariance is not None and covariance.shape == (6, 6)
        rotation, position = _errors(scene, pose)
        within.append(rotation < error_radius_deg(covariance[:3, :3]))
        within.append(position < error_radius(covariance[3:, 3:]))
    assert 0.75 <= np.mean(within) <= 1.0


def test_hypotheses_of_few_matches_are_no_start() -> None:
    """PoseLib would draw from them for ever."""
    sights = []
    for sight in _sights(world_scene())[:2]:
        hypothesis = sight.hypotheses[0]
        few = np.arange(len(sight)) < 4
        hypothesis = replace(hypothesis, inliers=few, in_front=few, R=hypothesis.R.T)
        sights.append(replace(sight, hypotheses=[hypothesis]))
    assert located(sights, [], EXACT, OPTIONS) is None
