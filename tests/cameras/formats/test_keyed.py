"""Files as OpenCV writes them, ROS's camera_info and Kalibr's camchain; lenses against OpenCV's;
keys of a lens in every format."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cameras.formats.opencv_files import assert_lens, write_storage

from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header

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


@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_opencv_in_each_syntax_and_length(tmp_path: Path, ending: str) -> None:
    values = {"image_width": 640, "image_height": 480, "camera_matrix": K}
    for count in (0, 4, 5, 8, 12):
        coefficients = np.array([*LENS, *[0.0] * 4])[:count].reshape(-1, 1)
        lens = {"distortion_coefficients": coefficients} if count else {}
        camera = parse_camera(write_storage(tmp_path / f"camera.{ending}", **values, **lens))
        np.testing.assert_array_equal(camera.K, K)
        assert_lens(camera, coefficients.ravel().tolist() or [0.0] * 4)
        assert camera.size == SIZE


def test_opencv_fisheye(tmp_path: Path) -> None:
    """`fisheye_model` as OpenCV's sample camera_calibration.cpp writes it."""
    lens = np.array(FISHEYE)
    camera = parse_camera(
        write_storage(tmp_path / "a.yml", fisheye_model=1, camera_matrix=K, D=lens)
    )
    assert_lens(camera, FISHEYE, is_fisheye=True)
    path = write_storage(tmp_path / "silent.yml", cameraMatrix=K, dist_coeffs=lens)
    assert parse_camera(f"{path}:fisheye").distortion == camera.distortion
    assert parse_camera(path).distortion == Distortion("OPENCV", tuple(FISHEYE))


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
        (KALIBR, "fov", [0.8]),
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
    if model == "fov":  # COLMAP's, as Kalibr's by Devernay and Faugeras
        assert camera.distortion == Distortion("FOV", (0.8,))
    else:
        assert_lens(camera, coefficients or [0.0] * 4, model == "equidistant")


def test_an_images_folder_names_its_camera_of_a_rig(tmp_path: Path) -> None:
    """Before a list of pairs does."""
    path = _write(tmp_path / "camchain.yaml", KALIBR.format(model="none", coefficients=[]))
    calibration, header = read_calibration(path), Header("PNG", SIZE)
    for image, focal in (("mav0/cam0/data/1.png", 500), ("mav0/cam1/data/1.png", 400)):
        camera = calibration.camera(tmp_path, image, header)
        assert (camera.K[0, 0], camera.warnings) == (focal, ())
        assert not calibration.lacks(tmp_path, image)
    assert calibration.lacks(tmp_path, "cam2/1.png")
    with pytest.raises(
        InputError, match=r"no camera for cam2/1\.png: choose one of cam0, cam1, as"
    ):
        calibration.camera(tmp_path, "cam2/1.png", header)
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
            "cam1: the key distortion_coeffs may describe the lens",
        ),
        ("distortion_model: ''\nheight: 480\nK: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n", "K must be upper"),
    ],
)
def test_a_camera_that_colmap_has_not_is_refused(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(InputError, match=f"c.yaml: .*{error}"):
        parse_camera(_write(tmp_path / "c.yaml", text))


MATRIX = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
FLAT = {"fx": 500, "fy": 510, "cx": 320, "cy": 240}
ROS_KEYS = {"image_width": 640, "image_height": 480, "distortion_model": "plumb_bob"}
NERF = {"fl_x": 500, "fl_y": 510, "cx": 320.5, "cy": 240.5}
KALIBR_KEYS = {"camera_model": "pinhole", "intrinsics": [500, 510, 320, 240], "resolution": SIZE}
RADTAN = {"distortion_model": "radtan", "distortion_coeffs": [-0.3, 0.1, 0.001, 0.002]}
RADTAN_LENS = Distortion("OPENCV", (-0.3, 0.1, 0.001, 0.002))
ONE_BY_ONE = {"k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": 0.002}

P0 = "500 0 320 0 0 510 240 0 0 0 1 0"


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


# A file's name, and its content with further keys: a text, or what JSON holds.
FORMATS: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "YAML": ("c.yml", lambda keys: {"camera_matrix": MATRIX, **keys}),
    "JSON": ("K.json", lambda keys: {"K": MATRIX, **keys}),
    "JSON of a pair": ("K.json", lambda keys: {"K1": MATRIX, "K2": MATRIX, **keys}),
    "JSON in a pair": ("K.json", lambda keys: {"K1": {"K": MATRIX, **keys}, "K2": MATRIX}),
    "JSON, deeper": ("K.json", lambda keys: {"K": MATRIX, "calibration": keys}),
    "ROS": ("ost.yaml", lambda keys: {**ROS_KEYS, "camera_matrix": {"data": MATRIX}, **keys}),
    "Kalibr": ("chain.yaml", lambda keys: {"cam0": {**KALIBR_KEYS, **RADTAN, **keys}}),
    "Kalibr, beside": ("chain.yaml", lambda keys: {"cam0": KALIBR_KEYS, **keys}),
    "EuRoC": ("sensor.yaml", lambda keys: {**KALIBR_KEYS, **RADTAN, **keys}),
    "NeRF": ("t.json", lambda keys: {**NERF, **keys, "frames": []}),
    "NeRF, frame": ("t.json", lambda keys: {**NERF, "frames": [{"file_path": "a", **keys}]}),
    "KITTI": (
        "calib.txt",
        lambda keys: "\n".join(
            f"{name}: {_words(value)}" for name, value in {"P0": P0, **keys}.items()
        ),
    ),
    "CSV": (
        "c.csv",
        lambda keys: "\n".join(
            ",".join(map(_words, row))
            for row in zip(*{"name": "a.png", **FLAT, **keys}.items(), strict=True)
        ),
    ),
}


def _with_keys(folder: Path, format: str, **keys: Any) -> str:
    name, content = FORMATS[format]
    data = content(keys)
    (folder / name).write_text(data if isinstance(data, str) else json.dumps(data))
    return str(folder / name)


def _camera(path: str) -> Camera:
    camera = read_calibration(path).camera(Path("cam0/image_0"), "a.png", Header("PNG", SIZE), "K1")
    assert camera.K.tolist() == MATRIX
    return camera


@pytest.mark.parametrize("format", FORMATS)
def test_a_key_that_is_not_read(tmp_path: Path, format: str) -> None:
    """Of a lens it is refused, of another camera told; zeros and what is of neither pass."""
    for key in ("k5", "dist_x", "lensDistortion", "xi", "skew", "fisheye_params", "orthographic"):
        for value in (0.1, [0.0, 0.1], "text"):
            with pytest.raises(
                InputError, match=f" {key} may describe the lens, and dgc-pose does not read it$"
            ):
                _camera(_with_keys(tmp_path, format, **{key: value}))
    others = {"K_right": 7, "new_camera_matrix": 7, "new_K": 3, "x_fov": 60, "binning_x": 2}
    camera = _camera(_with_keys(tmp_path, format, **others))
    assert camera.warnings == (f"keys that may change K are not read: {', '.join(others)}",)
    harmless = {"k5": 0, "dist_x": [0, 0.0], "xi": "", "avg_reprojection_error": 0.3, "flags": 4}
    harmless |= {"board_distance": 2, "timeshift_cam_imu": 0.1, "per_view_errors": [0.2, 0.1]}
    camera = _camera(_with_keys(tmp_path, format, **harmless, binning_x=1, binning_y=0))
    assert camera.distortion == _camera(_with_keys(tmp_path, format)).distortion
    assert camera.warnings == ()


@pytest.mark.parametrize("name", ["dist", "dist_coeff", "distCoeffs", "D", "k1 k2 p1 p2"])
@pytest.mark.parametrize("format", ["YAML", "JSON in a pair", "ROS", "CSV", "NeRF", "EuRoC"])
def test_a_lens_by_any_of_its_names(tmp_path: Path, format: str, name: str) -> None:
    lens = ONE_BY_ONE if name[0] == "k" else {name: [*RADTAN_LENS.coefficients]}
    if format == "EuRoC":
        lens = {"distortion_coeffs": None, **lens}
    assert _camera(_with_keys(tmp_path, format, **lens)).distortion == RADTAN_LENS


@pytest.mark.parametrize("model", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}])
@pytest.mark.parametrize("format", ["YAML", "CSV", "NeRF, frame"])
def test_a_fisheye_by_its_model(tmp_path: Path, format: str, model: dict[str, Any]) -> None:
    lens = {"k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004}
    expected = Distortion("OPENCV_FISHEYE", tuple(lens.values()))
    assert _camera(_with_keys(tmp_path, format, **lens, **model)).distortion == expected
    with pytest.raises(InputError, match="p1 may describe the lens"):
        _camera(_with_keys(tmp_path, format, **lens, **model, p1=0.1))


@pytest.mark.parametrize(
    "data",
    [
        {"K": MATRIX, "width": 640, "height": 480, "resolution": 5},
        {**NERF, "w": 640, "h": 480, "width": 1280, "height": 960, "image_size": 3},
        {**NERF, "w": 640, "h": 480, "mask": {"k1": 3}},
    ],
)
def test_what_else_a_file_holds_is_no_size_and_no_lens(tmp_path: Path, data: object) -> None:
    camera = _camera(_write(tmp_path / "a.json", json.dumps(data)))
    assert (camera.size, camera.distortion, camera.warnings) == (SIZE, None, ())
