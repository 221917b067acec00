"""Cameras of many images from files and options; a K of the pixels as stored or of the upright
image, for the upright image."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from dgc_pose.cameras.by_image import Calibration, KDetails, upright_camera
from dgc_pose.cameras.calibration import (
    camera_data,
    pair_cameras,
    parse_camera_data,
    read_calibration,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.prior import LENS_STD
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.images.image import Image, turned

K = [[500, 0, 320], [0, 510, 238], [0, 0, 1]]

SIZE = (640, 480)


def _K(calibration: Calibration, name: str) -> list[float]:
    K = calibration.camera(Path("photos"), name, Header("JPEG", SIZE)).K
    return [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("whole", [False, True])
def test_a_colmap_model(tmp_path: Path, binary: bool, whole: bool) -> None:
    """COLMAP's principal point is half a pixel more than ours."""
    model = pycolmap.Reconstruction()
    for number, focal in ((1, 500.0), (2, 600.0)):
        camera = pycolmap.Camera.create_from_model_name(number, "OPENCV", focal, *SIZE)
        camera.params = [focal, focal, 320.5, 240.5, 0.01, 0, 0, 0]
        model.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=f"d/{number}.jpg", camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    model.image(2).name = "d/2 é%20.jpg"
    model.write_binary(tmp_path) if binary else model.write_text(tmp_path)
    ending = "bin" if binary else "txt"
    source = tmp_path if whole else tmp_path / f"cameras.{ending}"
    calibration = read_calibration(str(source))
    assert _K(calibration, "d/1.jpg") == [500, 500, 320, 240]
    assert _K(calibration, "d/2 é%20.jpg") == [600, 600, 320, 240]
    lens = calibration.camera(tmp_path, "d/1.jpg", Header("JPEG", SIZE)).distortion
    assert lens == Distortion("OPENCV", (0.01, 0, 0, 0))
    (tmp_path / f"images.{ending}").unlink()
    with pytest.raises(
        InputError, match=f"has no camera for d/1.jpg: choose one of 1, 2, as in {source}:2"
    ):
        _K(read_calibration(str(source)), "d/1.jpg")
    assert _K(read_calibration(f"{source}:2"), "d/1.jpg") == [600, 600, 320, 240]


def test_an_image_without_a_camera(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^K has no camera for a\.jpg$"):
        _K(read_calibration(None), "a.jpg")
    path = tmp_path / "K.csv"
    path.write_text("name,fx,fy,cx,cy\na.jpg,500,510,320,240\n")
    assert _K(read_calibration(str(path)), "a.jpg") == [500, 510, 320, 240]
    with pytest.raises(InputError, match=f"^{path} has no camera for b.jpg$"):
        _K(read_calibration(str(path)), "b.jpg")


def test_cameras_survive_json() -> None:
    camera = Camera(
        np.array([[500, 0.5, 320], [0, 510, 240.25], [0, 0, 1]]),
        SIZE,
        Distortion("SIMPLE_RADIAL", (0.1,)),
        ("a warning",),
        focal_std=0.02,
        centre_std=3.0,
        focal_source="exif",
        identity="a",
    )
    data = json.loads(json.dumps(camera_data(camera)))
    again = parse_camera_data(data)
    np.testing.assert_array_equal(again.K, camera.K)
    assert {**vars(again), "K": None} == {**vars(camera), "K": None}
    with pytest.raises(ValueError, match="focal_source"):
        parse_camera_data({**data, "focal_source": "a star"})


def _images(*sizes: tuple[int, int]) -> list[Image]:
    return [Image(np.zeros((height, width, 3), np.uint8)) for width, height in sizes]


def test_images_without_K_share_a_camera_by_their_size_or_as_told() -> None:
    images = _images(SIZE, SIZE, (320, 200))
    for word, expected in (
        ("auto", [True, False]),
        ("auto:shared", [True, True]),
        ("auto:two", [False, False]),
    ):
        calibration = read_calibration(word)
        first, *others = (calibration.camera(Path("photos"), "a.jpg", image) for image in images)
        assert first.focal_std > 0 and first.focal_source == "size"
        same = [camera.identity == first.identity is not None for camera in others]
        assert same == expected
        pairs = [pair_cameras(word, word, images[0], image) for image in images[1:]]
        assert [one.identity == other.identity for one, other in pairs] == expected
    first, *_, second = images
    camera1, camera2 = pair_cameras(None, "500,500,160,100", first, second)
    assert (camera1.focal_std > 0, camera2.focal_std) == (True, 0)
    with pytest.raises(InputError, match="^K1 is auto:two, and K2 is auto$"):
        pair_cameras("auto:two", None, first, second)
    with pytest.raises(InputError, match="^K1: 'auto:both' is neither auto, auto:shared, auto:two"):
        pair_cameras("auto:both", None, first, second)


@pytest.mark.parametrize(
    ("text", "size", "error"),
    [
        ("500,510,160,238", (640, 240), "320x240 has another aspect ratio"),
        ("500,510,160,160", (320, 320), "K is for 320x320 pixels, and the image of 320x240 has"),
        ("PINHOLE,640,480,500,510,320,240", (1280, 960), "K states 640x480, and K_size 1280x960"),
        ("500,510,320,240", (160, 120), "641x481 pixels; the image has 160x120"),
        ("auto", SIZE, "K_size needs a K, and K states none"),
    ],
)
def test_a_size_that_K_cannot_have(text: str, size: tuple[int, int], error: str) -> None:
    (image,) = _images((320, 240))
    with pytest.raises(InputError, match=error):
        pair_cameras(text, text, image, image, ("K", "K"), KDetails(size=size))


def test_the_deviation_of_a_K() -> None:
    first, second = _images(SIZE, SIZE)
    details = KDetails(focal_std=0.02, centre_std=3.0)
    text = "500,510,320,240"
    camera1, camera2 = pair_cameras(text, text, first, second, ("--K", "--K"), details)
    assert (camera1.focal_std, camera1.centre_std, camera1.focal_source) == (0.02, 3.0, "given")
    assert camera1.identity == camera2.identity is not None
    camera1, camera2 = pair_cameras(text, text, first, second, ("--K1", "--K2"), details)
    assert camera1.identity != camera2.identity
    camera1, camera2 = pair_cameras("auto", text, first, second, ("--K1", "--K"), details)
    assert camera1.focal_source != "given" and camera1.focal_std != 0.02
    assert camera2.focal_std == 0.02
    with pytest.raises(InputError, match="^K_std needs a K, and K states none$"):
        read_calibration("auto", details=details)


def test_a_lens_that_is_not_known() -> None:
    (image,) = _images((320, 200))
    for text, std in (
        ("300,300,159.5,99.5,lens", LENS_STD),
        ("PINHOLE,320,200,300,300,160,100,lens", LENS_STD),
        ("300,300,159.5,99.5", 0.0),
        ("SIMPLE_RADIAL,320,200,300,160,100,0.1,lens", 0.0),  # its lens is known
    ):
        for camera in pair_cameras(text, text, image, image, ("--K", "--K")):
            assert (camera.lens_std, camera.exact, camera.focal_std) == (std, std == 0, 0)


LENS = Distortion("OPENCV", (0.1, 0.02, 0.01, -0.03))


def _header(orientation: int) -> Header:
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
    camera = upright_camera(given, _header(orientation))
    assert (camera is not given) is is_turned
    assert camera.warnings[0] == "a" and len(camera.warnings) == 1 + warns
    assert all(f"orientation {orientation} rotates K" in text for text in camera.warnings[1:])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_point_projects_to_the_pixel_that_is_turned(orientation: int) -> None:
    """With tangential coefficients of both signs, by the turn of the pixels themselves."""
    K = np.array([[440.0, 0, 310.0], [0, 450, 250], [0, 0, 1]])
    stored = Camera(K, SIZE, LENS)
    numbers = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE[::-1])
    upright = upright_camera(stored, _header(orientation))
    pixels = turned(numbers, orientation)
    y, x = np.divmod(np.random.default_rng(0).choice(numbers.ravel(), 20), SIZE[0])
    rays = stored.normalise(np.column_stack([x, y]))
    in_upright = np.array([np.argwhere(pixels == number)[0, ::-1] for number in numbers[y, x]])
    turned_rays = upright.normalise(in_upright.astype(np.float64))
    np.testing.assert_allclose(np.abs(turned_rays).sum(1), np.abs(rays).sum(1), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(turned_rays, axis=1), np.linalg.norm(rays, axis=1))


def test_a_K_of_another_size_is_scaled() -> None:
    (image,) = _images((320, 240))
    expected = Camera(np.array(K), SIZE).resized((320, 240))
    details = KDetails(size=SIZE)
    for value in ("PINHOLE,640,480,500,510,320.5,238.5", np.array(K)):
        camera, _ = pair_cameras(value, value, image, image, details=details)
        np.testing.assert_allclose(camera.K, expected.K)
        assert (camera.size, camera.warnings) == ((320, 240), ())
