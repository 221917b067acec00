"""Lenses that are computed without pycolmap against pycolmap, and deviations of a camera."""

import numpy as np
import pycolmap
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError

POINTS = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
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
    seen = camera.img_from_cam(np.column_stack([POINTS, np.ones(len(POINTS))]))
    np.testing.assert_allclose(lens.apply(POINTS), seen, atol=1e-9)
    np.testing.assert_allclose(lens.undo(seen), POINTS, atol=1e-5)


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


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("RADIAL", (0.1,)),
        ("OPENCV", (0.1, np.inf, 0.0, 0.0)),
        ("CYLINDER", (0.1, 0.0)),
    ],
)
def test_a_lens_of_other_coefficients_is_refused(
    model: str, coefficients: tuple[float, ...]
) -> None:
    with pytest.raises(InputError, match=model):
        Distortion(model, coefficients)


def test_a_lens_deviation_is_for_lenses_of_two_coefficients() -> None:
    for model, *coefficients in (("RADIAL", 0.1, 0), ("OPENCV_FISHEYE", 0.1, 0, 0, 0)):
        lens = Distortion(model, tuple(coefficients))
        assert Camera(MATRIX, distortion=lens).exact
        assert not Camera(MATRIX, distortion=lens, lens_std=0.1).exact
    for model, *coefficients in (
        ("OPENCV_FISHEYE", 0.1, 0, 0.01, 0),
        ("OPENCV", 0.1, 0, 0, 0),
        ("CYLINDER",),
    ):
        lens = Distortion(model, tuple(coefficients))
        with pytest.raises(InputError, match="^lens_std must be 0 with the lens "):
            Camera(MATRIX, distortion=lens, lens_std=0.1)
