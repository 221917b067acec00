"""What methods are told of the cameras, and what a pose says of them."""

import dense_scene
import numpy as np
import pytest

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import auto_cameras
from dgc_pose.images.image import Image

IMAGE = Image(np.zeros((240, 320, 3), np.uint8))
CAMERA = Camera(dense_scene.K)


def pair() -> PosedPair:
    truth = Truth({}, CAMERA, CAMERA, dense_scene.R, dense_scene.T)
    return PosedPair(truth, IMAGE, IMAGE)


def test_without_a_trial_the_methods_get_the_lists_cameras() -> None:
    posed = pair()
    cameras = CameraTrial().cameras(posed)
    assert cameras[0] is posed.truth.camera1 and cameras[1] is posed.truth.camera2


@pytest.mark.parametrize(
    ("k", "sharing"), [("auto", "files"), ("auto:shared", "shared"), ("auto:two", "two")]
)
def test_a_K_that_is_withheld_is_that_of_the_images(k, sharing) -> None:
    told = CameraTrial(k=k).cameras(pair())
    for camera, expected in zip(told, auto_cameras(IMAGE, IMAGE, sharing), strict=True):
        assert np.array_equal(camera.K, expected.K)
        assert (camera.focal_std, camera.identity) == (expected.focal_std, expected.identity)
    assert (told[0].identity == told[1].identity) == (k != "auto:two")


def test_a_wrong_K_is_wrong_by_what_was_asked_for() -> None:
    for camera in CameraTrial(k_scale=0.8).cameras(pair()):
        assert camera.K == pytest.approx(np.array([[240, 0, 159.5], [0, 240, 119.5], [0, 0, 1]]))
        assert camera.focal_std == 0
    assert CAMERA.K[0, 0] == 300
