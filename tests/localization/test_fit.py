"""The pose of a photograph by the matches of all references."""

from dataclasses import replace

import numpy as np
import poselib
from worlds import CAMERA, OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.estimation.covariance import error_radius, error_radius_deg
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior
from dgc_pose.localization.correspondences import (
    PairCorrespondences,
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
    before = located(sights[:3], [], EXACT, OPTIONS)
    for start in (None, before):
        pose = located(sights, [], EXACT, OPTIONS, start)
        assert pose is not None and pose.parameters.shape == (SIZE,)
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
    truth = poselib.CameraPose()
    truth.R, truth.t = scene.R, -scene.R @ scene.centre
    theirs, _ = poselib.refine_generalized_relative_pose(
        matches, truth, references, [camera] * len(sights), [poselib.CameraPose()], [camera]
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
