"""Files as OpenCV writes them, ROS's camera_info and Kalibr's camchain; lenses against OpenCV's."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.cameras.calibration import pair_cameras, parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header
from dgc_pose.images.image import Image

K = np.array([[500.0, 0, 321.25], [0, 510, 238.5], [0, 0, 1]])
SIZE = (640, 480)
PLUMB_BOB = [-0.21, 0.06, 0.002, -0.001, 0.013]
LENS = [*PLUMB_BOB, 0.02, 0.01, 0.004]
FISHEYE = [-0.03, 0.005, -0.001, 0.0002]

# As camera_calibration_parsers writes it (sensor_msgs/CameraInfo: K of the raw image, row by row).
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0., 321.25, 0., 5.1e+02, 238.5, 0., 0., 1.]
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {count}, data: {coefficients}}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [480, 0, 320, 0, 0, 480, 240, 0, 0, 0, 1, 0]}}
"""

# As `ros2 topic echo` prints the message, with the line that ends it.
MESSAGE = """header: {stamp: {sec: 1}, frame_id: camera}
height: 480
width: 640
distortion_model: plumb_bob
d: [-0.21, 0.06, 0.002, -0.001, 0.013]
k: [500.0, 0.0, 321.25, 0.0, 510.0, 238.5, 0.0, 0.0, 1.0]
---
"""

# The example of Kalibr's wiki, "Yaml formats", with other numbers.
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [500.0, 510.0, 321.25, 238.5]
  distortion_model: {model}
  distortion_coeffs: {coefficients}
  T_cam_imu:
  - [0.01779318, 0.99967549,-0.01822936, 0.07008565]
  timeshift_cam_imu: -8.121e-05
  rostopic: /cam0/image_raw
  resolution: [640, 480]
cam1:
  camera_model: pinhole
  intrinsics: [400.0, 410.0, 319.5, 239.5]
  distortion_model: none
  distortion_coeffs: []
  T_cn_cnm1:
  - [ 0.99998854, 0.00216014, 0.00427195,-0.11003785]
  resolution: [640, 480]
"""


def _write(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def _pixels() -> np.ndarray:
    return np.random.default_rng(0).uniform((60, 40), (580, 440), (30, 2))


def _assert_lens(camera: Camera, model: str, coefficients: list[float]) -> None:
    """OpenCV projects the camera's rays back onto the pixels."""
    lens = np.array(coefficients)
    points = camera.normalise(_pixels())
    if model == "equidistant":
        again = cv2.fisheye.distortPoints(points[:, None], K, lens)
    else:
        rays = np.column_stack([points, np.ones(len(points))])
        again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, lens)
    np.testing.assert_allclose(again[:, 0], _pixels(), atol=1e-3)


def _write_storage(path: Path, **values: object) -> str:
    """A file as OpenCV writes it; the ending tells YAML, XML or JSON."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return str(path)


@pytest.mark.parametrize("ending", ["yml", "yaml", "xml", "json"])
def test_opencv_in_each_syntax_and_length(tmp_path: Path, ending: str) -> None:
    values = {"image_width": 640, "image_height": 480, "camera_matrix": K}
    for count in (0, 4, 5, 8, 12):
        coefficients = np.array([*LENS, *[0.0] * 4])[:count].reshape(-1, 1)
        lens = {"distortion_coefficients": coefficients} if count else {}
        camera = parse_camera(_write_storage(tmp_path / f"camera.{ending}", **values, **lens))
        _assert_lens(camera, "opencv", coefficients.ravel().tolist() or [0.0] * 4)
        assert camera.size == SIZE


def test_opencv_fisheye(tmp_path: Path) -> None:
    """`fisheye_model` as OpenCV's sample camera_calibration.cpp writes it."""
    values = {"camera_matrix": K, "D": np.array(FISHEYE)}
    camera = parse_camera(_write_storage(tmp_path / "a.yml", fisheye_model=1, **values))
    expected = cv2.fisheye.undistortPoints(_pixels()[:, None], K, values["D"])[:, 0]
    np.testing.assert_allclose(camera.normalise(_pixels()), expected, atol=1e-6)
    path = _write_storage(tmp_path / "silent.yml", cameraMatrix=K, dist_coeffs=values["D"])
    assert parse_camera(f"{path}:fisheye").distortion == camera.distortion
    assert parse_camera(path).distortion == Distortion("OPENCV", tuple(FISHEYE))
    np.testing.assert_array_equal(parse_camera(path).K, K)


EUROC = (  # The sensor.yaml of EuRoC's sequences, which begins as OpenCV's YAML does.
    "%YAML:1.0\n# General sensor definitions.\nsensor_type: camera\nresolution: [640, 480]\n"
    "camera_model: pinhole\nintrinsics: [500.0, 510.0, 321.25, 238.5] #fu, fv, cu, cv\n"
    f"distortion_model: radial-tangential\ndistortion_coefficients: {PLUMB_BOB[:4]}\n"
)


@pytest.mark.parametrize(
    ("text", "model", "coefficients"),
    [
        (ROS, "plumb_bob", PLUMB_BOB),
        (ROS, "rational_polynomial", LENS),
        (ROS, "equidistant", FISHEYE),
        (MESSAGE, "plumb_bob", PLUMB_BOB),
        (KALIBR, "radtan", PLUMB_BOB[:4]),
        (KALIBR, "equidistant", FISHEYE),
        (KALIBR, "none", []),
        (EUROC, "radtan", PLUMB_BOB[:4]),
    ],
)
def test_ros_kalibr_and_euroc(
    tmp_path: Path, text: str, model: str, coefficients: list[float]
) -> None:
    if text in (ROS, KALIBR):
        text = text.format(model=model, count=len(coefficients), coefficients=coefficients)
    path = _write(tmp_path / "c.yaml", text)
    camera = parse_camera(f"{path}:cam0" if "cam1" in text else path)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.size == SIZE
    _assert_lens(camera, model, coefficients or [0.0] * 4)


def test_kalibr_fov(tmp_path: Path) -> None:
    """Devernay and Faugeras: r_distorted = atan(2 r tan(w / 2)) / w."""
    text = KALIBR.format(model="fov", coefficients=[0.8])
    camera = parse_camera(f"{_write(tmp_path / 'camchain.yaml', text)}:cam0")
    ideal = np.array([[0.3, -0.2], [0.5, 0.4]])
    radius = np.linalg.norm(ideal, axis=1, keepdims=True)
    distorted = ideal * np.arctan(2 * radius * np.tan(0.4)) / 0.8 / radius
    np.testing.assert_allclose(camera.normalise(distorted @ K[:2, :2] + K[:2, 2]), ideal, atol=1e-9)


def test_which_camera_of_a_rig(tmp_path: Path) -> None:
    """By the image's folder, by FILE:PART, or of a pair by their order, with a warning."""
    path = _write(tmp_path / "camchain.yaml", KALIBR.format(model="none", coefficients=[]))
    calibration, header = read_calibration(path), Header("PNG", SIZE)
    for image, focal in (("mav0/cam0/data/1.png", 500), ("mav0/cam1/data/1.png", 400)):
        camera = calibration.camera(tmp_path, image, header)
        assert (camera.K[0, 0], camera.warnings) == (focal, ())
    with pytest.raises(InputError, match=r"no camera for cam2/1\.png: state one of cam0, cam1, as"):
        calibration.camera(tmp_path, "cam2/1.png", header)
    image = Image(np.zeros((480, 640, 3), np.uint8))
    first, second = pair_cameras(path, path, image, image)
    assert (first.K[0, 0], second.K[0, 0]) == (500, 400)
    assert "by their order cam0 is that of image 1" in first.warnings[0]
    assert pair_cameras(path, f"{path}:cam1", image, image)[1].warnings == ()
    with pytest.raises(InputError, match=r"has cam0, cam1, and no cam2$"):
        parse_camera(f"{path}:cam2")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (ROS.format(model="thin_prism", count=0, coefficients=[]), "'thin_prism' has no COLMAP"),
        (ROS.format(model="plumb_bob", count=12, coefficients=[0.1] * 12), "a thin prism"),
        (KALIBR.format(model="radtan", coefficients=[1]), "1 distortion coefficients"),
        (
            KALIBR.replace("pinhole", "ds").format(model="none", coefficients=[]),
            "'ds' has no COLMAP",
        ),
        (KALIBR.format(model="poly", coefficients=[1]), "cam0: the distortion_model 'poly'"),
        (
            KALIBR.format(model="none", coefficients=[]).replace("[]\n  T_cn", "[0.1]\n  T_cn"),
            "cam1: distortion_coeffs may be of the lens",
        ),
        ("distortion_model: ''\nheight: 480\nK: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n", "K must be upper"),
    ],
)
def test_a_camera_that_colmap_has_not_is_refused(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(InputError, match=f"c.yaml: .*{error}"):
        parse_camera(_write(tmp_path / "c.yaml", text))
