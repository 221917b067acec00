"""Which K's are refused or warned of, and what is said."""

import numpy as np
import pytest

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.checks import checked_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError

SIZE = (1600, 1200)


@pytest.mark.parametrize(
    "text",
    [
        "1400,1400,799.5,599.5",
        "1400,1400,840,560",  # 2.5 and 3 % off the middle
        "1400,1400,839.5,629.5",  # 5 % too large on both sides
        "215,215,799.5,599.5",  # 149.8 degrees
        "91000,91000,799.5,599.5",  # 1.007 degrees
        "PINHOLE,1600,1200,1400,1400,800,600",
    ],
)
def test_a_usual_K_passes_without_a_word(text: str) -> None:
    assert checked_camera(parse_camera(text), SIZE, "--K1").warnings == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "1100,1100,639.5,479.5",
            "--K1 has its principal point at (639.5, 479.5), the middle of an image of about "
            "1280x960, and the image has 1600x1200: --K-size 1280x960 scales it",
        ),
        (
            "1400,1400,599.5,799.5",
            "--K1 has its principal point at (599.5, 799.5), the middle of an image of about "
            "1200x1600, and the image has 1600x1200: K is of the image turned by 90 degrees",
        ),
        (
            "1400,1400,300,599.5",
            "--K1 has its principal point at (300, 599.5), far from the middle of the image of "
            "1600x1200",
        ),
        (  # of a part of a photograph
            "PINHOLE,1600,1200,700,700,400,300",
            "--K1 has its principal point at (399.5, 299.5), far from the middle of the image of "
            "1600x1200",
        ),
        (
            "95000,95000,799.5,599.5",
            "--K1 has a focal length of 95000 pixels, which is a field of view of 0.965 degrees in "
            "the image of 1600x1200; K is in pixels of the image",
        ),
    ],
)
def test_a_K_that_may_be_of_another_image_is_a_warning(text: str, said: str) -> None:
    assert checked_camera(parse_camera(text), SIZE, "--K1").warnings == (said,)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "2800,2800,1599.5,1199.5",
            "--K1 has its principal point at (1599.5, 1199.5), the middle of an image of about "
            "3200x2400, and the image has 1600x1200: --K-size 3200x2400 scales it",
        ),
        (
            "700,700,399.5,299.5",
            "--K1 has its principal point at (399.5, 299.5), the middle of an image of about "
            "800x600, and the image has 1600x1200: --K-size 800x600 scales it",
        ),
        (
            "1400,1400,1700,300",
            "--K1 has its principal point at (1700, 300), outside the image of 1600x1200",
        ),
        ("1400,1400,-10,600", "--K1 has its principal point at (-10, 600), outside the image"),
        (
            "35,35,799.5,599.5",
            "--K1 has a focal length of 35 pixels, which is a field of view of 175 degrees in the "
            "image of 1600x1200; K is in pixels of the image",
        ),
        ("1.2,1.2,0.5,0.5", "--K1 has a focal length of 1.2 pixels"),
        (
            "PINHOLE,800,600,700,700,400,300",
            "--K1 is for an image of 800 x 600 pixels, the image has 1600 x 1200: "
            "--K-size 800x600 scales it",
        ),
        (
            "PINHOLE,1200,1600,1400,1400,600,800",
            "--K1 is for an image of 1200 x 1600 pixels, the image has 1600 x 1200: "
            "K is of the image turned by 90 degrees",
        ),
        (
            "PINHOLE,1600,900,1400,1400,800,450",
            "--K1 is for an image of 1600 x 900 pixels, the image has 1600 x 1200",
        ),
    ],
)
def test_a_K_that_cannot_be_of_the_image_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_camera(parse_camera(text), SIZE, "--K1")
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize("seed", range(3))
def test_every_scale_of_a_right_K_is_told_with_its_size(seed: int) -> None:
    """The middle of a photograph of any size, up to 2 % beside it, against the image's size."""
    rng = np.random.default_rng(seed)
    for scale in (0.1, 0.25, 0.5, 0.75, 0.85, 1.2, 1.5, 2, 4, 10):
        size = np.round(np.array(SIZE) * scale)
        K = np.eye(3)
        K[:2, 2] = (size - 1) / 2 * (1 + rng.uniform(-0.01, 0.01, 2))
        K[0, 0] = K[1, 1] = 1400 * scale
        try:
            (said,) = checked_camera(Camera(K), SIZE, "--K").warnings
        except InputError as error:
            said = str(error)
        width, height = map(int, said.split("--K-size ")[1].split()[0].split("x"))
        np.testing.assert_allclose((width, height), size, rtol=0.02)


def test_a_fisheye_may_see_more_than_a_pinhole() -> None:
    lens = Distortion("OPENCV_FISHEYE", (0.0, 0.0, 0.0, 0.0))
    K = np.array([[200.0, 0, 799.5], [0, 200, 599.5], [0, 0, 1]])
    assert checked_camera(Camera(K, SIZE, lens), SIZE, "K").warnings == ()
    with pytest.raises(InputError, match="field of view of 152 degrees"):
        checked_camera(Camera(K, SIZE), SIZE, "K")
