"""What the options of K make of their texts."""

import numpy as np
import pytest

from dgc_pose.cli.options import CameraChoice, KChoice, parse_deviations, parse_size
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image

IMAGE = Image(np.zeros((240, 320, 3), np.uint8))
K = "500,510,320,240"


def test_sizes_and_deviations() -> None:
    assert parse_size(" 1600x1200 ") == parse_size("1600X1200") == (1600, 1200)
    assert parse_deviations("0.02") == (0.02, 0)
    assert parse_deviations("0.02, 3") == (0.02, 3)
    details = KChoice(K, (640, 480), (0.02, 3.0)).details
    assert (details.size, details.focal_std, details.centre_std) == ((640, 480), 0.02, 3)
    for text in ("1600", "1600x", "0x1", "-1x2", "1.5x2", ""):
        with pytest.raises(InputError, match="^--K-size must be WxH in pixels, such as 1600x1200"):
            parse_size(text)
    for text in ("", "a", "-1", "0.1,2,3", "2", "0.1,-1", "nan", "0.1,inf"):
        with pytest.raises(InputError, match="^--K-std must be F or F,C"):
            parse_deviations(text)


def test_the_cameras_of_a_pair() -> None:
    choice = CameraChoice(K, (640, 480), (0.02, 3.0), k2="PINHOLE,640,480,400,400,320,240")
    camera1, camera2 = choice.resolve(IMAGE, IMAGE)
    assert (camera1.K[0, 0], camera2.K[0, 0]) == (250, 200)
    assert camera1.focal_std == camera2.focal_std == 0.02
    assert camera1.identity != camera2.identity
    camera1, camera2 = CameraChoice("auto", k1="160,160,160,120").resolve(IMAGE, IMAGE)
    assert (camera1.focal_std, camera2.focal_source) == (0, "size")
    camera1, camera2 = CameraChoice(fov=90, k_std=(0.1, 2.0)).resolve(IMAGE, IMAGE)
    assert camera1.focal == camera2.focal == pytest.approx(160) and camera2.focal_std == 0.1
    with pytest.raises(InputError, match="^--K2: 'K' is neither"):
        CameraChoice("160,160,160,120", k2="K").resolve(IMAGE, IMAGE)
