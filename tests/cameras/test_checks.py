"""Which K's are refused or warned of."""

import numpy as np
import pytest

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.checks import checked_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError

SIZE = (1600, 1200)
LENS = Distortion("OPENCV_FISHEYE", (0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "camera",
    [
        parse_camera("1400,1400,799.5,599.5"),
        parse_camera("1400,1400,840,560"),  # 2.5 and 3 % off the middle
        parse_camera("1400,1400,839.5,629.5"),  # 5 % too large on both sides
        parse_camera("215,215,799.5,599.5"),  # 149.8 degrees
        parse_camera("91000,91000,799.5,599.5"),  # 1.007 degrees
        parse_camera("PINHOLE,1600,1200,1400,1400,800,600"),
        Camera(np.array([[200.0, 0, 799.5], [0, 200, 599.5], [0, 0, 1]]), SIZE, LENS),
    ],
)
def test_a_usual_K_passes(camera: Camera) -> None:
    assert checked_camera(camera, SIZE, "--K1").warnings == ()


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        (
            "1100,1100,639.5,479.5",
            "--K1 has its principal point at (639.5, 479.5), the middle of an image of about "
            "1280x960, and the image has 1600x1200: --K-size 1280x960 scales it",
        ),
        ("1400,1400,599.5,799.5", "1200x1600, and the image has 1600x1200: K is of the image turn"),
        ("1400,1400,300,599.5", "at (300, 599.5), far from the middle of the image of 1600x1200"),
        ("PINHOLE,1600,1200,700,700,400,300", "at (399.5, 299.5), far from the middle"),
        ("95000,95000,799.5,599.5", "a focal length of 95000 pixels, which is a field of view of"),
    ],
)
def test_a_K_that_may_be_of_another_image_has_a_warning(text: str, warning: str) -> None:
    (text,) = checked_camera(parse_camera(text), SIZE, "--K1").warnings
    assert text.startswith("--K1 has ") and warning in text


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("2800,2800,1599.5,1199.5", "the middle of an image of about 3200x2400"),
        ("700,700,399.5,299.5", "800x600, and the image has 1600x1200: --K-size 800x600 scales it"),
        ("1400,1400,1700,300", "at (1700, 300), outside the image of 1600x1200"),
        ("1400,1400,-10,600", "at (-10, 600), outside the image"),
        ("35,35,799.5,599.5", "a focal length of 35 pixels, which is a field of view of 175 deg"),
        ("1.2,1.2,0.5,0.5", "a focal length of 1.2 pixels"),
        (
            "PINHOLE,800,600,700,700,400,300",
            "of 800 x 600 pixels, the image has 1600 x 1200: --K-size 800x600 scales it",
        ),
        ("PINHOLE,1200,1600,1400,1400,600,800", "1600 x 1200: K is of the image turned by 90 deg"),
        ("PINHOLE,1600,900,1400,1400,800,450", "of 1600 x 900 pixels, the image has 1600 x 1200"),
    ],
)
def test_a_K_that_cannot_be_of_the_image_is_refused(text: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_camera(parse_camera(text), SIZE, "--K1")
    assert str(caught.value).startswith("--K1 ") and error in str(caught.value)


def test_every_scale_of_a_right_K_is_recognised() -> None:
    """The middle of a photograph of any size, up to 2 % beside it, against the image's size."""
    rng = np.random.default_rng(0)
    for scale in 3 * (0.1, 0.25, 0.5, 0.75, 0.85, 1.2, 1.5, 2, 4, 10):
        size = np.round(np.array(SIZE) * scale)
        K = np.diag([1400 * scale, 1400 * scale, 1])
        K[:2, 2] = (size - 1) / 2 * (1 + rng.uniform(-0.01, 0.01, 2))
        try:
            (text,) = checked_camera(Camera(K), SIZE, "--K").warnings
        except InputError as error:
            text = str(error)
        width, height = map(int, text.split("--K-size ")[1].split()[0].split("x"))
        np.testing.assert_allclose((width, height), size, rtol=0.02)
