"""Cameras: the matrix, what is refused, resizing, points without an inverse, checks of K; lenses
against pycolmap's."""

import cv2
import numpy as np
import pycolmap
import pytest
import torch

from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.calibration import pair_cameras, parse_camera
from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Exif
from dgc_pose.images.image import Image

K = np.array([[810.0, 1.5, 321.25], [0, 790, 238.5], [0, 0, 1]])
SIZE = (640, 480)
PIXELS = np.random.default_rng(5).uniform(-0.5, np.array(SIZE) - 0.5, (200, 2))


def test_normalise_inverts_K_with_its_skew() -> None:
    homogeneous = np.column_stack([PIXELS, np.ones(len(PIXELS))])
    expected = np.linalg.solve(K, homogeneous.T).T[:, :2]
    np.testing.assert_allclose(Camera(K).normalise(PIXELS), expected, atol=1e-13)
    np.testing.assert_allclose(Camera(K).project(expected), PIXELS, atol=1e-10)
    for camera in (Camera(K), Camera(K, SIZE, Distortion("OPENCV", (-0.2, 0.05, 0.002, -0.001)))):
        assert camera.normalise(np.empty((0, 2))).shape == (0, 2)
        normalised = camera.normalise(np.array([[np.nan, 3.0], [np.inf, 3.0], [300.0, 200.0]]))
        assert np.isfinite(normalised).all(axis=1).tolist() == [False, False, True]
        for shape in ((2,), (4, 3)):
            with pytest.raises(InputError, match="points"):
                camera.normalise(np.zeros(shape))


@pytest.mark.parametrize(
    "value",
    [
        *(K, K.tolist(), torch.tensor(K[None]), Camera(K)),
        np.block([[K, np.zeros((3, 1))], [0, 0, 0, 1]]),
    ],
    ids=lambda value: f"{type(value).__name__} {np.shape(value)}",
)
def test_a_pair_takes_what_callers_have(value: object) -> None:
    image = Image(np.zeros((480, 640, 3), np.uint8))
    camera, _ = pair_cameras(value, K, image, image)
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1
    np.testing.assert_array_equal(camera.K, K)
    assert camera.focal == 800
    four = matrix_camera([810.0, 790.0, 321.25, 238.5])
    np.testing.assert_array_equal(four.K, K - [[0, 1.5, 0], [0, 0, 0], [0, 0, 0]])


def test_a_pair_takes_pycolmaps_cameras() -> None:
    image = Image(np.zeros((480, 640, 3), np.uint8))
    parameters = [500, 510, 320, 240, -0.2, 0.05, 0.002, -0.001]
    theirs = pycolmap.Camera(model="OPENCV", width=640, height=480, params=parameters)
    camera, _ = pair_cameras(theirs, K, image, image)
    assert camera.size == (640, 480)
    expected = theirs.cam_from_img(PIXELS + 0.5)
    np.testing.assert_allclose(camera.normalise(PIXELS), expected, atol=1e-8)
    for wrong, message in ((pycolmap.Camera(), "'INVALID' is not"), (theirs, "image 2 has 64")):
        with pytest.raises(InputError, match=f"^K2.*{message}"):
            pair_cameras(K, wrong, image, Image(np.zeros((48, 64, 3), np.uint8)))


def test_a_field_of_view_is_that_of_the_upright_image() -> None:
    """Between the rays through the left and right edges, half a pixel beyond the outer centres."""
    images = [
        Image(np.zeros((size[1], size[0], 3), np.uint8), exif=Exif(orientation=n))
        for size, n in ((SIZE, 1), (SIZE[::-1], 6), (SIZE, 3))
    ]
    for image in images:
        camera, _ = pair_cameras(None, None, image, image, fov=50.0)
        size = image.size
        assert (camera.size, camera.exact, camera.warnings) == (size, True, ())
        edges = camera.normalise(np.array([[-0.5, 0], [size[0] - 0.5, 0]]))[:, 0]
        np.testing.assert_allclose(np.degrees(np.arctan(edges)), [-25, 25])
    for fov in (0.5, 160, np.nan, -60):
        with pytest.raises(InputError, match="^fov must be an angle of 1 to 150 degrees"):
            pair_cameras(None, None, *images, fov=fov)
    with pytest.raises(InputError, match="^fov must be a number, not 'wide'$"):
        pair_cameras(None, None, *images, fov="wide")  # type: ignore[arg-type]


def test_an_unusable_K_is_refused_in_one_line_that_names_the_argument() -> None:
    for value, message in (
        (K[:2], "shape"),
        (np.block([[K, np.ones((3, 1))], [0, 0, 0, 1]]), "shape"),
        ([["a"] * 3] * 3, "not an array"),
        (np.where(K == 810, np.inf, K), "not finite"),
        (K.T, "last row"),
        (K + [[0, 0, 0], [5, 0, 0], [0, 0, 0]], "upper triangular"),
    ):
        with pytest.raises(InputError, match=f"^K2 .*{message}"):
            matrix_camera(value, "K2")
    for text in (
        "",
        "gone/K.txt",
        "500,500,a,240",
        "PINHOLE,0,480,700,720,330,250",
        "OPENCV,640,480,700,720,330,250,nan,0,0,0",
        "PINEHOLE,640,480,700,720,330,250",
        "x" * 5000,
        "a\0b",
    ):
        for files in (True, False):
            with pytest.raises(InputError, match="^K1") as caught:
                parse_camera(text, "K1", files=files)
            assert "\n" not in str(caught.value)


def test_resized_follows_a_spot_in_a_resized_image() -> None:
    """A spot at the principal point is still there in the image averaged over blocks of pixels."""
    camera = Camera(np.array([[100.0, 0, 41], [0, 100, 26], [0, 0, 1]]), (80, 64))
    spot = np.zeros((64, 80))
    spot[26, 41] = 1
    averaged = cv2.GaussianBlur(spot, (0, 0), 4).reshape(16, 4, 20, 4).mean((1, 3))
    rows, columns = np.indices(averaged.shape)
    moved = np.array([(columns * averaged).sum(), (rows * averaged).sum()]) / averaged.sum()
    small = camera.resized((20, 16))
    np.testing.assert_allclose(small.K[:2, 2], moved, atol=1e-3)
    assert (small.K[0, 0], small.size) == (25, (20, 16))


def test_a_pixel_that_no_ray_reaches_becomes_nan() -> None:
    fisheye = parse_camera("SIMPLE_FISHEYE,640,480,100,320,240")
    beyond = np.array([[319.5 + 100 * np.pi / 2 + 1, 239.5], [319.5 + 100, 239.5]])
    normalised = fisheye.normalise(beyond)
    assert np.isnan(normalised[0]).all()
    np.testing.assert_allclose(normalised[1], [np.tan(1), 0], atol=1e-9)
    # x (1 - 0.4 x^2) never exceeds 0.61.
    barrel = Camera(np.eye(3), None, Distortion("SIMPLE_RADIAL", (-0.4,)))
    normalised = barrel.normalise(np.array([[0.7, 0.0], [0.3, 0.0]]))
    assert np.isnan(normalised[0]).all()
    x = normalised[1, 0]
    assert x * (1 - 0.4 * x**2) == pytest.approx(0.3, abs=1e-9)


LARGE = (1600, 1200)


@pytest.mark.parametrize(
    ("text", "warning", "error"),
    [
        ("1400,1400,799.5,599.5", "", ""),
        (
            "1100,1100,639.5,479.5",
            "at (639.5, 479.5), the middle of about 1280x960",
            "",
        ),
        ("1400,1400,300,599.5", "at (300, 599.5), far from the middle of image 2 of 1600x1200", ""),
        ("2800,2800,1599.5,1199.5", "", "the middle of about 3200x2400"),
        ("700,700,399.5,299.5", "", "about 800x600 pixels; image 2 has 1600x1200"),
        ("1400,1400,599.5,799.5", "", "K is of the image rotated by 90 degrees"),
        ("1400,1400,557.5,855.5", "", "K is of the image rotated by 90 degrees"),  # 3.5 % off
        ("1400,1400,690,670", "", ""),  # 7 and 6 % off the middle
        ("1400,1400,1700,300", "", "at (1700, 300), outside image 2 of 1600x1200"),
        ("35,35,799.5,599.5", "", "a focal length of 35 pixels, a field of view above 150 degrees"),
        ("PINHOLE,800,600,700,700,400,300", "", "of 800 x 600 pixels, image 2 has 1600 x 1200"),
        ("PINHOLE,1200,1600,1400,1400,600,800", "", "x 1200: K is of the image rotated by 90 deg"),
    ],
)
def test_a_K_is_checked_by_its_size_and_its_principal_point(
    text: str, warning: str, error: str
) -> None:
    camera = parse_camera(text)
    if error:
        with pytest.raises(InputError) as caught:
            checked_camera(camera, LARGE, "--K1", "image 2")
        assert str(caught.value).startswith("--K1 ") and error in str(caught.value)
        return
    warnings = checked_camera(camera, LARGE, "--K1", "image 2").warnings
    assert len(warnings) == bool(warning)
    assert all(told.startswith("--K1 has ") and warning in told for told in warnings)


RAYS = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
MATRIX = np.array([[800.0, 0, 500], [0, 800, 400], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "coefficients", "projection"),
    [
        ("RADIAL", (-0.2, 0.05), "plane"),
        ("OPENCV_FISHEYE", (0.0, 0.0, 0.0, 0.0), "angles"),
        ("OPENCV_FISHEYE", (-0.05, 0.01, 0.0, 0.0), "angles"),
        ("OPENCV_FISHEYE", (-0.05, 0.01, 0.0, -0.01), None),
        ("SIMPLE_RADIAL", (-0.2,), None),
    ],
)
def test_a_lens_is_that_of_colmap_whoever_computes_it(
    model: str, coefficients: tuple[float, ...], projection: str | None
) -> None:
    lens = Distortion(model, coefficients)
    assert lens.projection == projection
    assert projection is None or lens.radial == coefficients[:2]
    camera = pycolmap.Camera.create_from_model_name(0, model, 1.0, 1, 1)
    parameters = np.zeros(len(camera.params))
    parameters[camera.focal_length_idxs()] = 1
    parameters[camera.extra_params_idxs()] = coefficients
    camera.params = parameters.tolist()
    seen = camera.img_from_cam(np.column_stack([RAYS, np.ones(len(RAYS))]))
    np.testing.assert_allclose(lens.apply(RAYS), seen, atol=1e-9)
    np.testing.assert_allclose(lens.undo(seen), RAYS, atol=1e-5)


def test_a_cylinder_has_no_coefficients_and_the_angle_as_x() -> None:
    lens = Distortion("CYLINDER")
    assert (lens.projection, lens.radial) == ("cylinder", (0.0, 0.0))
    np.testing.assert_allclose(lens.apply(np.array([[1.0, 1.0]])), [[np.pi / 4, 0.5**0.5]])
    camera = Camera(MATRIX, (1000, 800), lens)
    pixels = np.array([[500 + 800 * np.radians(50), 700.0], [500 - 800 * 1.6, 400]])
    normalised = camera.normalise(pixels)
    expected = [np.tan(np.radians(50)), 300 / 800 / np.cos(np.radians(50))]
    np.testing.assert_allclose(normalised[0], expected)
    assert np.isnan(normalised[1]).all()
    np.testing.assert_allclose(camera.project(normalised[:1]), pixels[:1])


def test_coefficients_and_deviations_that_a_lens_does_not_have_are_refused() -> None:
    """Another number of coefficients, and a deviation but of a lens of two coefficients."""
    for model, coefficients in (
        ("RADIAL", (0.1,)),
        ("OPENCV", (0.1, np.inf, 0.0, 0.0)),
        ("CYLINDER", (0.1, 0.0)),
    ):
        with pytest.raises(InputError, match=model):
            Distortion(model, coefficients)
    for model, *numbers in (("RADIAL", 0.1, 0), ("OPENCV_FISHEYE", 0.1, 0, 0, 0)):
        lens = Distortion(model, tuple(numbers))
        assert Camera(MATRIX, distortion=lens).exact
        assert not Camera(MATRIX, distortion=lens, lens_std=0.1).exact
    for model, *numbers in (
        ("OPENCV_FISHEYE", 0.1, 0, 0.01, 0),
        ("OPENCV", 0.1, 0, 0, 0),
        ("CYLINDER",),
    ):
        with pytest.raises(InputError, match="^lens_std must be 0 with the lens "):
            Camera(MATRIX, distortion=Distortion(model, tuple(numbers)), lens_std=0.1)
