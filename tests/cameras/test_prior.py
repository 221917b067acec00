"""The camera of an image without K: focal lengths by hand from EXIF data of known numbers."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import box_picture

from dgc_pose.cameras.calibration import camera_data, image_camera, pair_cameras, parse_camera_data
from dgc_pose.cameras.lines import log_likelihoods
from dgc_pose.cameras.prior import (
    SIZE_FOCAL,
    SIZE_STD,
    auto_camera,
    auto_cameras,
    with_lines,
    with_part,
)
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.images.image import Image

SIZE = (4000, 3000)  # a diagonal of 5000


SENSOR = Exif(focal_mm=50, pixels_per_mm=4000 / 36)
NO_EXIF = Exif()
PHONE = Exif("Maker", "X1", focal_35mm=26)


def photo(exif: Exif = NO_EXIF, size: tuple[int, int] = SIZE, orientation: int = 1) -> Header:
    """orientation: that the image has had applied."""
    size = size if orientation < 5 else size[::-1]
    return Header("JPEG", size, replace(exif, orientation=orientation))


CANON = Exif("Canon", "Canon EOS 5D Mark II", focal_mm=50)  # 36 mm in COLMAP's table
STALE = replace(CANON, pixels_per_mm=100, size=(900, 600))  # an editor left the resolution


@pytest.mark.parametrize(
    ("exif", "size", "focal", "stds"),
    [
        (NO_EXIF, (1000, 800), 900, (SIZE_STD, SIZE_STD)),
        (Exif("Maker", "X1", focal_mm=50), SIZE, 3600, (SIZE_STD, SIZE_STD)),
        # On film, short ones rounded by more per cent: of 4:3 by the diagonal, at any size; it goes
        # before that of the lens.
        (Exif(focal_35mm=13, focal_mm=13 / 6, pixels_per_mm=2000), SIZE, 1502.2, (0.082, 0.09)),
        (Exif(focal_35mm=26, focal_mm=26 / 6, pixels_per_mm=2000), SIZE, 3004.4, (0.06, 0.081)),
        (Exif(focal_35mm=300, focal_mm=50, pixels_per_mm=2000), SIZE, 34666.1, (0.06, 0.081)),
        (replace(PHONE, size=SIZE), (800, 600), 600.9, (0.06, 0.081)),
        # 16:9 may be a part: by its diagonal 26 mm are 2757.6 px, by that of 4:3 they are 3004.4.
        (PHONE, (4000, 2250), np.sqrt(2757.6 * 3004.4), (0.07, 0.1)),
        # A sensor of 36 mm with 4000 pixels, and a lens of 50 mm.
        (SENSOR, SIZE, 5555.6, (0.05, 0.1)),
        (replace(SENSOR, size=SIZE), (3000, 4000), 5555.6, (0.05, 0.1)),
        (replace(SENSOR, size=SIZE), (1000, 750), 1388.9, (0.05, 0.1)),
        (replace(SENSOR, size=SIZE, digital_zoom=2), SIZE, 11111.1, (0.1, 0.2)),
        (replace(SENSOR, focal_35mm=65535), SIZE, 5555.6, (0.05, 0.1)),  # which no camera has
        (CANON, (3600, 2400), 5000, (0.08, 0.08)),
        (CANON, (240, 360), 500, (0.08, 0.08)),
        (STALE, (900, 600), 1250, (0.05, 0.1)),
    ],
)
def test_the_focal_length_of_each_source(
    exif: Exif, size: tuple[int, int], focal: float, stds: tuple[float, float]
) -> None:
    camera = auto_camera(photo(exif, size))
    assert camera.focal == pytest.approx(focal, rel=1e-4)
    assert camera.focal_source == ("size" if stds[0] == SIZE_STD else "exif")
    assert stds[0] - 1e-9 <= camera.focal_std <= stds[1] + 1e-9
    middle = (np.array(size) - 1) / 2
    np.testing.assert_array_equal(
        camera.K, [[camera.focal, 0, middle[0]], [0, camera.focal, middle[1]], [0, 0, 1]]
    )
    assert (camera.size, camera.warnings, camera.centre_std) == (size, (), 0.005 * max(size))
    assert camera.identity is not None and camera.lens_std > 0


def test_the_lens_of_an_action_camera_is_known_least() -> None:
    action = Exif("GoPro", "HERO9 Black", focal_35mm=26)
    assert auto_camera(photo(action)).lens_std > auto_camera(photo(PHONE)).lens_std > 0


@pytest.mark.parametrize(
    ("exif", "warning"),
    [
        (Exif(focal_35mm=35856), "35856 mm on 35 mm film"),
        (Exif(focal_35mm=177, focal_mm=3.99), "177 mm on 35 mm film and 3.99 mm of the lens"),
        (Exif(focal_mm=50, pixels_per_mm=4e6), "50 mm of the lens"),
        (Exif(focal_35mm=26, size=(1000, 3000)), "26 mm on 35 mm film"),
    ],
)
def test_a_focal_length_that_no_camera_has(exif: Exif, warning: str) -> None:
    """The files of one camera state 35856 mm, those of a telephone 177 mm for a small image: with a
    lens of 4 mm, a sensor of 1 mm. No part of an image is wider than it; but larger it may be."""
    camera = auto_camera(photo(exif))
    assert (camera.focal, camera.focal_std, camera.focal_source) == (3600, SIZE_STD, "size")
    assert warning in camera.warnings[0] and "the size is used instead" in camera.warnings[0]
    camera = auto_camera(photo(Exif(focal_35mm=26, size=(400, 300))))
    assert (camera.focal_source, camera.warnings) == ("exif", ())


def test_a_digital_zoom_may_be_in_the_focal_length_on_film() -> None:
    """50 mm at four times are 50 or 200 mm."""
    camera = auto_camera(photo(Exif("Apple", focal_35mm=50, digital_zoom=4)))
    ends = np.log(np.array([50, 200]) / 43.27 * 5000)
    assert np.abs(ends - np.log(camera.focal)).max() < 1.05 * camera.focal_std < 0.8
    assert (camera.focal_source, camera.warnings) == ("exif", ())


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
    camera = auto_camera(photo(replace(PHONE, size=SIZE), size))
    (warning,) = camera.warnings
    assert f"{size[0]}x{size[1]} pixels, cropped or squeezed from the 4000x3000" in warning
    assert "of the EXIF data: focal length" in warning
    ends = np.log(3004.4 * np.array(scales))
    assert np.log(camera.focal) == pytest.approx(ends.mean(), abs=1e-4)
    assert np.abs(ends - np.log(camera.focal)).max() < camera.focal_std
    assert camera.focal_std > auto_camera(photo(PHONE)).focal_std
    np.testing.assert_array_equal(camera.K[:2, 2], (np.array(size) - 1) / 2)
    assert camera.centre_std > 50


@pytest.mark.parametrize("exif", [NO_EXIF, PHONE, replace(SENSOR, size=SIZE)])
@pytest.mark.parametrize("whole", [SIZE, SIZE[::-1]])
@pytest.mark.parametrize("squeezed", [(3000, 3000), (1000, 3000)])
def test_pixels_that_are_not_square(
    exif: Exif, whole: tuple[int, int], squeezed: tuple[int, int]
) -> None:
    """The camera of a squeezed image is that of the whole one, resized along one axis."""
    aspect = whole[0] / squeezed[0] * squeezed[1] / whole[1]
    camera = auto_camera(replace(photo(exif, squeezed), pixel_aspect=aspect))
    expected = auto_camera(photo(exif, whole)).resized(squeezed)
    np.testing.assert_allclose(camera.K, expected.K, rtol=1e-9)
    assert camera.focal_std == pytest.approx(expected.focal_std)
    assert (camera.focal_source, camera.warnings) == (expected.focal_source, ())


EXIF = Exif("Maker", "X1", "back camera", 5.1, 26)
WIDE = replace(photo(EXIF), pixel_aspect=1.25)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (photo(EXIF), photo(EXIF), True),
        (photo(EXIF), photo(EXIF, SIZE[::-1]), True),
        (photo(EXIF), photo(EXIF, orientation=6), True),
        (photo(EXIF), photo(replace(EXIF, digital_zoom=2)), False),
        (photo(EXIF), photo(replace(EXIF, focal_mm=1.5)), False),
        (photo(EXIF), photo(replace(EXIF, lens="front camera")), False),
        (photo(EXIF), photo(replace(EXIF, model="X2")), False),
        (photo(EXIF), photo(replace(EXIF, size=(4000, 2250))), False),
        (photo(EXIF), photo(EXIF, (2000, 1500)), False),
        (photo(EXIF), photo(), False),
        (photo(), photo(size=SIZE[::-1]), True),
        (photo(), photo(size=(4000, 2999)), False),
        (WIDE, replace(WIDE, size=SIZE[::-1], pixel_aspect=0.8), True),
        (WIDE, replace(WIDE, size=SIZE[::-1]), False),
        (WIDE, photo(EXIF), False),
    ],
)
def test_one_camera_if_size_and_exif_agree(first: Header, second: Header, same: bool) -> None:
    camera1, camera2 = auto_cameras(first, second)
    assert (camera1.identity == camera2.identity) is same


def test_a_shared_camera_has_the_exif_data_of_either_image() -> None:
    for bare in (photo(), photo(size=SIZE[::-1])):
        for images in ((photo(EXIF), bare), (bare, photo(EXIF))):
            camera1, camera2 = auto_cameras(*images, "shared")
            assert camera1.focal == camera2.focal == pytest.approx(3004.4, rel=1e-4)
            assert camera1.focal_std == camera2.focal_std < 0.1
            assert (camera1.focal_source, camera2.focal_source) == ("exif", "exif")
            assert camera2.K[0, 2] == (images[1].size[0] - 1) / 2
    camera1, camera2 = auto_cameras(WIDE, replace(photo(orientation=6), pixel_aspect=0.8), "shared")
    np.testing.assert_array_equal(camera2.K.diagonal()[:2], camera1.K.diagonal()[1::-1])
    camera1, camera2 = auto_cameras(photo(EXIF), photo(size=(800, 600)), "shared")
    assert (camera1.focal_source, camera2.focal_source) == ("exif", "size")


def test_a_panorama_by_the_file_alone_has_its_projection() -> None:
    for name in ("", "equirectangular", "cylindrical"):
        header = replace(photo(EXIF, (40, 20)), projection=name)
        camera = auto_camera(header)
        assert camera.projection == name
        assert parse_camera_data(camera_data(camera)).projection == name
        given = image_camera(camera.K, Image(np.zeros((20, 40, 3), np.uint8), projection=name))
        assert given.projection == ""
        np.testing.assert_array_equal(camera.K, auto_camera(replace(header, projection="")).K)


BOX = Image(box_picture(1.2))  # 960 x 720: 1152 pixels
BLANK = Image(np.full((720, 960, 3), 90, np.uint8))


@pytest.mark.parametrize("image", [photo(), photo(size=SIZE[::-1]), photo(PHONE), WIDE])
def test_a_camera_is_the_usual_part_of_its_belief(image: Header) -> None:
    """Beside which there are long lenses, or EXIF data of another image."""
    camera = auto_camera(image)
    usual = camera.focal_prior.usual
    tail = camera.focal_prior.tail
    main = with_part(camera, usual)
    np.testing.assert_allclose(main.K, camera.K, rtol=1e-9)
    assert main.focal_std == camera.focal_std == usual.std
    assert np.exp([usual.log_weight, tail.log_weight]).sum() == pytest.approx(1)
    assert tail.std > usual.std and usual.log_weight > tail.log_weight
    assert not camera.focal_prior.lines.any()
    if camera.focal_source == "size":
        assert np.exp(usual.log_focal) == pytest.approx(SIZE_FOCAL)
        assert abs(np.log(5.2) - tail.log_focal) < 1.5 * tail.std


def test_the_lines_of_an_image_are_its_focal_length() -> None:
    before = auto_camera(BOX)
    (camera,) = with_lines([before], [BOX])
    assert (camera.focal_source, camera.warnings) == ("lines", ())
    assert abs(np.log(camera.focal / 1152)) < min(0.1, 3 * camera.focal_std)
    assert camera.focal_std < 0.5 * SIZE_STD
    np.testing.assert_array_equal(camera.focal_prior.lines, log_likelihoods(BOX))
    np.testing.assert_array_equal(camera.K[:2, 2], before.K[:2, 2])
    assert (camera.identity, camera.centre_std) == (before.identity, before.centre_std)


def test_a_camera_stays_if_the_lines_tell_nothing() -> None:
    masked = replace(BOX, mask=np.zeros((720, 960), bool))
    for image in (BLANK, masked, replace(BOX, pixel_aspect=1.25), replace(BLANK, exif=PHONE)):
        before = auto_camera(image)
        for camera in with_lines(2 * [before], 2 * [image]):
            assert camera is before and camera.focal_source != "lines"


@pytest.mark.parametrize("film", [13, 135])
def test_exif_data_that_the_lines_contradict_have_a_warning(film: int) -> None:
    """1152 pixels are 41.5 mm on 35 mm film at 960 x 720. The lines of two images are surer than
    EXIF data, which few files have of another image; those of one are about as sure."""
    exif = Exif("Maker", "X1", focal_35mm=film)
    images = [replace(BOX, exif=exif), Image(box_picture(1.2, (40, -25, -5)), exif=exif)]
    cameras = auto_cameras(*images)
    for before, camera in zip(cameras, with_lines(cameras, images), strict=True):
        assert camera.focal_source == "lines" and before.focal_source == "exif"
        assert abs(np.log(camera.focal / 1152)) < min(0.1, 3 * camera.focal_std)
        (warning,) = camera.warnings
        assert warning.startswith(f"the lines of the image give f = {camera.focal:.0f} px +- ")
        assert warning.endswith(f" %, EXIF data {before.focal:.0f}: using the lines")


def test_images_of_one_camera_count_together() -> None:
    cameras = auto_cameras(BOX, BLANK)
    assert cameras[0].identity == cameras[1].identity
    first, second = with_lines(cameras, [BOX, BLANK])
    np.testing.assert_array_equal(first.K, second.K)
    assert first.focal_std == second.focal_std < 0.5 * SIZE_STD
    assert (first.focal_source, second.focal_source) == ("lines", "lines")
    # Each has the lines of its own image, for two focal lengths.
    assert first.focal_prior.lines.any() and not second.focal_prior.lines.any()
    other = Image(box_picture(0.6))
    alone = with_lines(auto_cameras(BOX, other, "two"), [BOX, other])
    assert [camera.focal for camera in alone] == pytest.approx([1152, 576], rel=0.1)
    together = with_lines(auto_cameras(BOX, other), [BOX, other])
    assert together[0].focal == together[1].focal


def test_a_stated_camera_has_no_lines() -> None:
    K = "1700,1700,480,360"
    stated = pair_cameras(K, K, BOX, BOX)
    alone = pair_cameras(K, None, BOX, BOX)
    for camera in (*stated, alone[0]):
        assert (camera.focal, camera.focal_source, camera.focal_prior) == (1700, "given", None)
        assert (camera.exact, camera.warnings) == (True, ())
    assert alone[1].focal_source == "lines"
    assert alone[1].focal == pytest.approx(1152, rel=0.1)
