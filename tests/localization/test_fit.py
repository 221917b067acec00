"""The pose of a photograph by the matches of all references, and the derivatives of their errors,
against finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import poselib
import pytest
from worlds import CAMERA, OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.covariance import error_radius, error_radius_deg
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.localization.correspondences import (
    PairCorrespondences,
    PointCorrespondences,
    WorldPose,
)
from dgc_pose.localization.fit import fitted, located, world_covariance
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
    for seed in range(24):
        scene = world_scene(seed=seed, count=100)
        sights = _sights(scene, seed)
        pose = located(sights, [], EXACT, OPTIONS)
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


STEP = 1e-6
FISHEYE = Distortion("OPENCV_FISHEYE", (0.02, -0.01, 0.0, 0.0))
RADIAL = Distortion("RADIAL", (0.05, -0.1))


def _moved(pose: WorldPose, change: np.ndarray, prior: IntrinsicsPrior) -> WorldPose:
    R = cv2.Rodrigues(change[:3])[0] @ pose.R
    parameters = pose.parameters + (prior.basis @ change[6:])[SIZE:]
    return WorldPose(R, pose.centre + change[3:6], parameters)


@pytest.mark.parametrize(("kind", "lens"), [("matches", FISHEYE), ("points", RADIAL)])
def test_slopes_are_derivatives(kind: str, lens: Distortion) -> None:
    scene = world_scene(count=40)
    photo = replace(PHOTO_CAMERA, distortion=lens, focal_std=0.1, centre_std=5.0, lens_std=0.05)
    photo = replace(photo, aspect_std=0.02)
    prior = IntrinsicsPrior.of(CAMERA, photo)
    sight: PairCorrespondences | PointCorrespondences = scene.sight(1, photo=photo)
    if kind == "points":
        places = photo.normalise(scene.pixels(PHOTO_CAMERA, scene.R, scene.centre))
        sight = PointCorrespondences(scene.points, places, lens, 0.01)
    pose = replace(scene.pose, parameters=np.array([0.02, 0.01, -0.01, 0.01, 0.02, 0.03]))
    _, slopes = sight.slopes(pose, prior)
    assert slopes.shape[1] == 6 + len(prior)
    for number in range(slopes.shape[1]):
        change = np.zeros(slopes.shape[1])
        change[number] = STEP
        ahead, behind = (
            sight.slopes(_moved(pose, sign * change, prior), prior)[0] for sign in (1, -1)
        )
        numeric = (ahead - behind) / (2 * STEP)
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(slopes[:, number], numeric, atol=2e-3 * scale)


def test_points_do_not_bias_the_focal_length() -> None:
    """The errors are of the image: a shorter focal length makes none of them smaller."""
    photo = replace(PHOTO_CAMERA, focal_std=0.45)
    prior = IntrinsicsPrior.of(CAMERA, photo)
    off = []
    for seed in range(30):
        scene = world_scene(seed=seed)
        pixels = scene.pixels(PHOTO_CAMERA, scene.R, scene.centre)
        pixels += np.random.default_rng(seed).normal(0, 3, pixels.shape)
        shown = PointCorrespondences(scene.points, photo.normalise(pixels), None, 12 / photo.focal)
        off.append(fitted([shown], scene.pose, prior).parameters[0])
    assert abs(np.mean(off)) < 3.5 * np.std(off) / len(off) ** 0.5


@pytest.mark.parametrize("kind", ["matches", "points"])
def test_a_skew_is_fitted_with_its_error(kind: str) -> None:
    """That of the photograph's pixels."""
    true = 0.04
    photo = replace(PHOTO_CAMERA, focal_std=0.1, centre_std=50.0, aspect_std=0.1)
    prior = IntrinsicsPrior.of(CAMERA, photo)
    scene = world_scene()
    skewed = [replace(s, problem=_skewed(s.problem, true)) for s in _sights(scene)]
    every: list[PairCorrespondences | PointCorrespondences] = [*skewed]
    if kind == "points":
        rng = np.random.default_rng(0)
        pixels = scene.pixels(PHOTO_CAMERA, scene.R, scene.centre) + rng.normal(0, 1, (300, 2))
        seen = photo.normalise(pixels)
        seen[:, 0] += true * seen[:, 1]
        every = [PointCorrespondences(scene.points, seen, None, 4 / photo.focal)]
    wide = [part.widened(4) for part in every]
    pose = fitted(every, fitted(wide, scene.pose, prior, skewed=True), prior, skewed=True)
    covariance = world_covariance(every, pose, prior, skewed=True)
    assert covariance is not None and covariance.shape == (7 + len(prior), 7 + len(prior))
    assert covariance[-1, -1] ** 0.5 < 0.003
    assert abs(pose.skew - true) < 4 * covariance[-1, -1] ** 0.5
    assert max(_errors(scene, pose)) < 0.5
    assert fitted(every, scene.pose, prior).skew == 0


def _skewed(problem: TwoViewProblem, skew: float) -> TwoViewProblem:
    points2 = problem.points2.copy()
    points2[:, 0] += skew * points2[:, 1]
    return replace(problem, points2=points2)
