"""Errors of a world pose and their derivatives, against finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from worlds import CAMERA, PHOTO_CAMERA, world_scene

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior
from dgc_pose.localization.correspondences import (
    PairCorrespondences,
    PointCorrespondences,
    WorldPose,
)
from dgc_pose.localization.fit import fitted

STEP = 1e-6
FISHEYE = Distortion("OPENCV_FISHEYE", (0.02, -0.01, 0.0, 0.0))
LENSES = [None, Distortion("RADIAL", (0.05, -0.1)), FISHEYE]


def _moved(pose: WorldPose, change: np.ndarray, prior: IntrinsicsPrior) -> WorldPose:
    R = cv2.Rodrigues(change[:3])[0] @ pose.R
    parameters = pose.parameters + (prior.basis @ change[6:])[SIZE:]
    return WorldPose(R, pose.centre + change[3:6], parameters)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("kind", ["matches", "points"])
def test_slopes_are_derivatives(kind: str, lens: Distortion | None) -> None:
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


def test_the_true_pose_has_the_errors_of_the_noise() -> None:
    scene = world_scene()
    sight = scene.sight(2)
    error, in_front = sight.errors(scene.pose)
    assert in_front[error < sight.threshold].mean() > 0.99
    assert 0.7 < (error < sight.threshold).mean() < 0.9  # a fifth are outliers
    assert sight.supports(scene.pose)
    turned = WorldPose(
        cv2.Rodrigues(np.array([0, 0.5, 0]))[0] @ scene.R, scene.centre, np.zeros(SIZE)
    )
    assert not sight.supports(turned)


def test_a_reference_at_the_same_place_has_a_finite_pose() -> None:
    scene = world_scene(np.array([[0.1, -0.2, 0.15], [1.0, 0, 0]]))
    R, t = scene.sight(1).pair_pose(replace(scene.pose, centre=scene.references[1][1]))
    assert np.isfinite(R).all() and np.linalg.norm(t) == pytest.approx(1)


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
