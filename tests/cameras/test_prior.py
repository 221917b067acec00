"""The camera of an image without K: focal lengths by hand from EXIF data of known numbers."""

from typing import Any

import numpy as np
import pytest
from exif_blocks import (
    FILM,
    FOCAL,
    HEIGHT,
    LENS,
    PLANE_UNIT,
    PLANE_X,
    PLANE_Y,
    WIDTH,
    ZOOM,
    exif_of,
)
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import SIZE_STD, auto_camera, auto_cameras, with_orientation
from dgc_pose.images.header import Exif, Header, read_exif

SIZE = (4000, 3000)  # a diagonal of 5000
FILM_DIAGONAL = np.hypot(36, 24)


def photo(
    tags: dict[int, Any] | None = None,
    size: tuple[int, int] = SIZE,
    make: str = "Maker",
    model: str = "X1",
    orientation: int = 1,
) -> Header:
    exif = Exif() if tags is None else read_exif(exif_of(tags, make, model).tobytes())
    return Header("JPEG", size, orientation, exif)


def mm(value: float) -> IFDRational:
    return IFDRational(round(value * 1000), 1000)


def whole(size: tuple[int, int] = SIZE) -> dict[int, int]:
    return {WIDTH: size[0], HEIGHT: size[1]}


# --- the focal length -----------------------------------------------------------------------------


def test_without_exif_the_size_says_little() -> None:
    camera = auto_camera(photo(size=(1000, 800)))
    np.testing.assert_array_equal(camera.K, [[1100, 0, 499.5], [0, 1100, 399.5], [0, 0, 1]])
    assert (camera.size, camera.focal_source, camera.focal_std) == ((1000, 800), "size", SIZE_STD)
    assert (camera.centre_std, camera.warnings) == (5, ())
    assert camera.identity is not None


@pytest.mark.parametrize(("film", "focal"), [(13, 1502.2), (26, 3004.4), (300, 34666.1)])
def test_the_focal_length_on_film(film: int, focal: float) -> None:
    """Of 4:3 by the diagonal, at any size; short ones are rounded by more per cent."""
    camera = auto_camera(photo({FILM: film}))
    assert camera.focal == pytest.approx(focal, rel=1e-4)
    small = auto_camera(photo({FILM: film, **whole()}, (800, 600)))
    assert small.focal == pytest.approx(camera.focal / 5)
    assert small.warnings == () and small.focal_std == camera.focal_std
    assert 0.06 < camera.focal_std < 0.07
    assert camera.focal_std > auto_camera(photo({FILM: 2 * film})).focal_std


def test_film_goes_before_the_sensor() -> None:
    tags = {FOCAL: mm(5), FILM: 26, PLANE_X: IFDRational(2000, 1), PLANE_UNIT: 4}
    assert auto_camera(photo(tags)).focal == pytest.approx(3004.4, rel=1e-4)


def test_the_resolution_of_the_sensor() -> None:
    """A sensor of 36 mm with 4000 pixels, and a lens of 50 mm: 5555.6 px."""
    tags = {FOCAL: mm(50), PLANE_X: mm(4000 / 36), PLANE_Y: mm(4000 / 36), PLANE_UNIT: 4}
    for size, focal in ((SIZE, 5555.6), ((3000, 4000), 5555.6), ((1000, 750), 1388.9)):
        camera = auto_camera(photo(tags | whole(), size))
        zoomed = auto_camera(photo(tags | whole() | {ZOOM: 2}, size))
        assert zoomed.focal == pytest.approx(2 * camera.focal) and zoomed.focal_std > 0.1
        assert camera.focal == pytest.approx(focal, rel=1e-4)
        assert camera.focal_source == "exif" and 0.05 <= camera.focal_std <= 0.1
    assert auto_camera(photo(tags)).focal == pytest.approx(5555.6, rel=1e-4)


def test_the_sensor_in_the_table_of_colmap() -> None:
    """An EOS 5D Mark II has 36 mm: 50 mm are 50 / 36 of the longer side."""
    pytest.importorskip("pycolmap")
    canon = {"make": "Canon", "model": "Canon EOS 5D Mark II"}
    for size in ((3600, 2400), (240, 360)):
        camera = auto_camera(photo({FOCAL: mm(50)}, size, **canon))
        assert camera.focal == pytest.approx(max(size) * 50 / 36, rel=1e-6)
        assert camera.focal_source == "exif" and camera.focal_std == pytest.approx(0.08)
    # An editor left the resolution of the image at four times its size.
    stale = {FOCAL: mm(50), PLANE_X: mm(100), PLANE_UNIT: 4, **whole((900, 600))}
    assert auto_camera(photo(stale, (900, 600), **canon)).focal == pytest.approx(1250, rel=1e-6)
    unknown = auto_camera(photo({FOCAL: mm(50)}))
    assert unknown.focal_source == "size" and unknown.warnings == ()


# --- what contradicts itself ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tags", "said"),
    [
        ({FILM: 35856}, "35856 mm on 35 mm film"),
        ({FILM: 3}, "3 mm on 35 mm film"),
        ({FILM: 177, FOCAL: mm(3.99)}, "177 mm on 35 mm film and 3.99 mm of the lens"),
        ({FOCAL: mm(50), PLANE_X: mm(4), PLANE_UNIT: 4}, "50 mm of the lens"),
        ({FOCAL: mm(50), PLANE_X: mm(4e6), PLANE_UNIT: 4}, "50 mm of the lens"),
        ({FILM: 26, **whole((400, 300))}, None),
        ({FILM: 26, **whole((1000, 3000))}, "26 mm on 35 mm film"),
    ],
)
def test_a_focal_length_that_no_camera_has(tags: dict[int, Any], said: str | None) -> None:
    """Of one camera the files hold 35856 mm, and of a telephone 177 mm for a small image: with a
    lens of 4 mm, a sensor of 1 mm. No part of an image is wider than it; but larger it may be."""
    camera = auto_camera(photo(tags))
    if said is None:
        assert (camera.focal_source, camera.warnings) == ("exif", ())
        return
    assert (camera.focal, camera.focal_std, camera.focal_source) == (4400, SIZE_STD, "size")
    (warning,) = camera.warnings
    assert said in warning and "is taken from the size" in warning and "\n" not in warning


def test_the_sensor_goes_in_for_an_impossible_film() -> None:
    tags = {FILM: 65535, FOCAL: mm(50), PLANE_X: mm(4000 / 36), PLANE_UNIT: 4}
    camera = auto_camera(photo(tags))
    assert camera.focal == pytest.approx(5555.6, rel=1e-4) and camera.warnings == ()


# --- zoom, parts, shapes --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "film", "lens", "focal"),
    [
        # 24 mm at five times, of which two are the sensor's middle: 121 mm, and 2.539 as the zoom
        ("Apple", 121, 6.765, 121 / 43.27 * 5000),
        # 23 mm at 2.539 times
        ("samsung", 23, 6.3, 2.539 * 23 / 43.27 * 5000),
    ],
)
def test_a_digital_zoom_is_in_the_equivalent_of_some_makers(
    make: str, film: int, lens: float, focal: float
) -> None:
    tags = {FILM: film, FOCAL: mm(lens)}
    zoomed = auto_camera(photo(tags | {ZOOM: mm(2.539)}, make=make))
    assert zoomed.focal == pytest.approx(focal, rel=1e-4) and zoomed.warnings == ()
    assert 0.1 < zoomed.focal_std < 0.15
    other = auto_camera(photo({FILM: 50, ZOOM: 4}))  # 50 or 200 mm
    ends = np.log(np.array([50, 200]) / 43.27 * 5000)
    assert np.abs(ends - np.log(other.focal)).max() < 1.05 * other.focal_std < 0.8
    assert other.focal_source == "exif"


@pytest.mark.parametrize(
    ("size", "scales"),
    [
        ((3000, 3000), (1, 1)),  # a side as long as it was: no other scale
        ((4000, 2250), (1, 1)),
        ((2000, 2000), (2 / 3, 1)),  # all of the height, or as large as it was
        ((1080, 1350), (1350 / 3000, 1)),
        ((1000, 1000), (1 / 3, 1)),
    ],
)
def test_a_part_of_an_image(size: tuple[int, int], scales: tuple[float, float]) -> None:
    camera = auto_camera(photo({FILM: 26, **whole()}, size))
    (warning,) = camera.warnings
    assert f"{size[0]} x {size[1]} pixels are a part of the 4000 x 3000" in warning
    ends = np.log(3004.4 * np.array(scales))
    assert np.log(camera.focal) == pytest.approx(ends.mean(), abs=1e-4)
    assert np.abs(ends - np.log(camera.focal)).max() < camera.focal_std
    assert camera.focal_std > auto_camera(photo({FILM: 26})).focal_std
    np.testing.assert_array_equal(camera.K[:2, 2], (np.array(size) - 1) / 2)
    assert camera.centre_std > 50


def test_an_image_of_16_to_9_may_be_a_part_of_the_sensor() -> None:
    """By its own diagonal 26 mm are 2757.6 px, by that of 4:3 they are 3004.4."""
    camera = auto_camera(photo({FILM: 26}, (4000, 2250)))
    assert camera.focal == pytest.approx(np.sqrt(2757.6 * 3004.4), rel=1e-4)
    assert camera.warnings == () and 0.07 < camera.focal_std < 0.1


# --- the identity ---------------------------------------------------------------------------------

TAGS = {FOCAL: mm(5.1), FILM: 26, LENS: "back camera", ZOOM: 1}


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (photo(TAGS), True),
        (photo(TAGS, SIZE[::-1]), True),
        (photo(TAGS, orientation=6), True),
        (photo(TAGS | {ZOOM: 2}), False),
        (photo(TAGS | {FILM: 13}), False),
        (photo(TAGS | {FOCAL: mm(1.5)}), False),
        (photo(TAGS | {LENS: "front camera"}), False),
        (photo(TAGS, make="Other"), False),
        (photo(TAGS, model="X2"), False),
        (photo(TAGS, (2000, 1500)), False),
        (photo(TAGS | whole((4000, 2250))), False),
        (photo(), False),
    ],
)
def test_one_camera_if_size_and_exif_agree(other: Header, same: bool) -> None:
    camera1, camera2 = auto_cameras(photo(TAGS), other)
    assert (camera1.identity == camera2.identity) is same


def test_one_camera_if_there_is_no_exif() -> None:
    for size, same in ((SIZE, True), (SIZE[::-1], True), ((4000, 2999), False)):
        camera1, camera2 = auto_cameras(photo(), photo(size=size, orientation=8))
        assert (camera1.identity == camera2.identity) is same


@pytest.mark.parametrize("turned", [False, True])
def test_a_shared_camera_has_the_exif_data_of_either_image(turned: bool) -> None:
    bare = photo(size=SIZE[::-1] if turned else SIZE)
    for images in ((photo(TAGS), bare), (bare, photo(TAGS))):
        camera1, camera2 = auto_cameras(*images, "shared")
        assert camera1.focal == camera2.focal == pytest.approx(3004.4, rel=1e-4)
        assert camera1.focal_std == camera2.focal_std < 0.1
        assert (camera1.focal_source, camera2.focal_source) == ("exif", "exif")
        assert camera2.K[0, 2] == (images[1].size[0] - 1) / 2
    camera1, camera2 = auto_cameras(photo(TAGS), photo(size=(800, 600)), "shared")
    assert (camera1.focal_source, camera2.focal_source) == ("exif", "size")


# --- the orientation ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("orientation", "centre", "size", "told"),
    [
        (1, (1700, 1700), None, False),
        (6, (1700, 1700), None, True),
        (6, (2010, 1490), None, False),  # the middle of the pixels as stored
        (6, (1490, 2010), None, True),  # the middle of the upright image
        (8, (1700, 1700), SIZE, False),  # K says it itself
        (3, (2010, 1490), SIZE, True),  # upside down: nothing says it
    ],
)
def test_an_orientation_is_told_of_a_K_that_may_be_for_the_upright_image(
    orientation: int, centre: tuple[float, float], size: tuple[int, int] | None, told: bool
) -> None:
    K = np.array([[4400.0, 0, centre[0]], [0, 4400, centre[1]], [0, 0, 1]])
    image = photo(TAGS, orientation=orientation)
    warnings = with_orientation(Camera(K, size, warnings=("a",)), image).warnings
    assert warnings[0] == "a" and len(warnings) == 1 + told
    assert all(f"orientation {orientation} is not applied" in text for text in warnings[1:])
    assert with_orientation(auto_camera(image), image).warnings == ()
