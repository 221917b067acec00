"""A K of the pixels as stored or of the upright image, for the upright image."""

import numpy as np
import pytest

from dgc_pose.cameras.by_image import upright_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.images.image import turned

SIZE = (640, 480)  # as stored
LENS = Distortion("OPENCV", (0.1, 0.02, 0.01, -0.03))


def header(orientation: int) -> Header:
    size = SIZE if orientation < 5 else SIZE[::-1]
    return Header("JPEG", size, Exif(orientation=orientation))


@pytest.mark.parametrize(
    ("orientation", "centre", "size", "is_turned", "warns"),
    [
        (1, (280, 280), None, False, False),
        (6, (280, 280), None, True, True),
        (6, (320, 239), None, True, False),  # the middle of the pixels as stored
        (6, (239, 320), None, False, False),  # the middle of the upright image
        (8, (280, 280), SIZE, True, False),  # by the size of K
        (8, (280, 280), SIZE[::-1], False, False),
        (3, (300, 239), SIZE, True, True),  # upside down
        (3, (319.5, 239.5), SIZE, True, False),  # K stays
    ],
)
def test_a_K_that_was_given_is_turned_unless_it_is_of_the_upright_image(
    orientation: int,
    centre: tuple[float, float],
    size: tuple[int, int] | None,
    is_turned: bool,
    warns: bool,
) -> None:
    K = np.array([[440.0, 0, centre[0]], [0, 450, centre[1]], [0, 0, 1]])
    given = Camera(K, size, warnings=("a",))
    camera = upright_camera(given, header(orientation))
    assert (camera is not given) is is_turned
    assert camera.warnings[0] == "a" and len(camera.warnings) == 1 + warns
    assert all(f"orientation {orientation} is applied" in text for text in camera.warnings[1:])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_point_projects_to_the_pixel_that_is_turned(orientation: int) -> None:
    """Of both signs of the tangential coefficients, by the turn of the pixels themselves."""
    K = np.array([[440.0, 0, 310.0], [0, 450, 250], [0, 0, 1]])
    stored = Camera(K, SIZE, LENS)
    numbers = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE[::-1])
    upright, pixels = upright_camera(stored, header(orientation)), turned(numbers, orientation)
    y, x = np.divmod(np.random.default_rng(0).choice(numbers.ravel(), 20), SIZE[0])
    rays = stored.normalise(np.column_stack([x, y]))
    in_upright = np.array([np.argwhere(pixels == number)[0, ::-1] for number in numbers[y, x]])
    turned_rays = upright.normalise(in_upright.astype(np.float64))
    np.testing.assert_allclose(np.abs(turned_rays).sum(1), np.abs(rays).sum(1), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(turned_rays, axis=1), np.linalg.norm(rays, axis=1))
