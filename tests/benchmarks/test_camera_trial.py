"""What methods are told of the cameras."""

import dense_scene
import numpy as np
import pytest
from boxes import box_picture

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import auto_cameras
from dgc_pose.images.image import Image

IMAGE = Image(np.zeros((240, 320, 3), np.uint8))
CAMERA = Camera(dense_scene.K)


@pytest.mark.parametrize(
    ("k", "sharing"), [("auto", "files"), ("auto:shared", "shared"), ("auto:two", "two")]
)
def test_a_K_that_is_withheld_is_that_of_the_images(k, sharing) -> None:
    truth = Truth({}, CAMERA, CAMERA, dense_scene.R, dense_scene.T)
    told = CameraTrial(k=k).cameras(PosedPair(truth, IMAGE, IMAGE))
    for camera, expected in zip(told, auto_cameras(IMAGE, IMAGE, sharing), strict=True):
        assert np.array_equal(camera.K, expected.K)
        assert (camera.focal_std, camera.identity) == (expected.focal_std, expected.identity)
    assert (told[0].identity == told[1].identity) == (k != "auto:two")


def test_a_K_that_is_withheld_has_what_the_lines_state() -> None:
    truth = Truth({}, CAMERA, CAMERA, dense_scene.R, dense_scene.T)
    image = Image(box_picture(1.2))
    for camera in CameraTrial(k="auto").cameras(PosedPair(truth, image, image)):
        assert camera.focal_source == "lines"
        assert abs(np.log(camera.focal / (1.2 * 960))) < 3 * camera.focal_std < 0.5
