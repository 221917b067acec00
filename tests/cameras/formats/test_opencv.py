"""Files of cv::FileStorage, written by OpenCV; the lens against OpenCV's own."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.errors import InputError

K = np.array([[500.0, 0, 321.25], [0, 510, 238.5], [0, 0, 1]])
SIZE = (640, 480)
LENS = [-0.21, 0.06, 0.002, -0.001, 0.013, 0.02, 0.01, 0.004]


def write_storage(path: Path, **values: object) -> str:
    """A file as OpenCV writes it; the ending tells YAML, XML or JSON."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return str(path)


def pixels() -> np.ndarray:
    return np.random.default_rng(0).uniform((60, 40), (580, 440), (30, 2))


@pytest.mark.parametrize("ending", ["yml", "yaml", "xml", "json"])
@pytest.mark.parametrize("count", [0, 4, 5, 8, 12])
def test_opencv_in_each_syntax_and_length(tmp_path: Path, ending: str, count: int) -> None:
    coefficients = np.array([*LENS, *[0.0] * 4])[:count].reshape(-1, 1)
    values = {"distortion_coefficients": coefficients} if count else {}
    path = write_storage(
        tmp_path / f"camera.{ending}", image_width=640, image_height=480, camera_matrix=K, **values
    )
    camera = parse_camera(path)
    rays = np.column_stack([camera.normalise(pixels()), np.ones(30)])
    again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, coefficients if count else None)
    np.testing.assert_allclose(again[:, 0], pixels(), atol=1e-3)
    assert camera.size == SIZE


def test_opencv_fisheye(tmp_path: Path) -> None:
    """`fisheye_model` as OpenCV's sample camera_calibration.cpp writes it."""
    coefficients = np.array([-0.03, 0.005, -0.001, 0.0002])
    path = write_storage(
        tmp_path / "fisheye.yml",
        fisheye_model=1,
        camera_matrix=K,
        distortion_coefficients=coefficients,
    )
    camera = parse_camera(path)
    expected = cv2.fisheye.undistortPoints(pixels()[:, None], K, coefficients)[:, 0]
    np.testing.assert_allclose(camera.normalise(pixels()), expected, atol=1e-6)
    assert camera.distortion is not None and camera.distortion.model == "OPENCV_FISHEYE"
    path = write_storage(tmp_path / "silent.yml", K=K, D=coefficients)
    assert parse_camera(f"{path}:fisheye").distortion == camera.distortion
    silent = parse_camera(path)
    assert silent.distortion is not None and silent.distortion.model == "OPENCV"
    assert silent.warnings == ()


@pytest.mark.parametrize(
    "names", [("cameraMatrix", "dist_coeffs"), ("K", "D"), ("camera_matrix", "distCoeffs")]
)
def test_other_names(tmp_path: Path, names: tuple[str, str]) -> None:
    path = write_storage(tmp_path / "c.yml", **{names[0]: K, names[1]: np.array(LENS[:4])})
    camera = parse_camera(path)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.distortion is not None and camera.distortion.coefficients == tuple(LENS[:4])
    assert camera.size is None


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"camera_matrix": K, "distortion_coefficients": np.full(12, 0.1)}, "a thin prism"),
        ({"camera_matrix": K, "distortion_coefficients": np.full(3, 0.1)}, "3 distortion coeff"),
        (
            {"camera_matrix": K, "D": np.full(4, 0.1), "xi": np.ones((1, 1))},
            ": xi may be of the lens",
        ),
        ({"rotation": np.eye(3)}, "no camera of OpenCV's"),
        ({"camera_matrix": np.eye(2)}, "camera_matrix must have positive focal"),
    ],
)
def test_what_is_no_camera_of_ours_is_named(
    tmp_path: Path, values: dict[str, np.ndarray], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        parse_camera(write_storage(tmp_path / "c.yml", **values))
    assert "c.yml" in str(caught.value)
