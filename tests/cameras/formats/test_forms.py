"""One camera in every form that is read. COLMAP's own forms are in test_colmap.py."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cameras.formats.camera_files import (
    FISHEYE,
    LENS,
    ROWS,
    SIZE,
    K,
    Storage,
    assert_lens,
    kalibr,
    table,
    write_file,
)

from dgc_pose.cameras.calibration import camera_data, parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion

FOUR = [500.0, 510.0, 321.25, 238.5]
FLAT = {"fx": 500, "fy": 510, "cx": 321.25, "cy": 238.5}
OTHER = [[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]  # of a second camera
BY_COLUMNS = K.T.ravel().tolist()
OPENCV = {"image_width": 640, "image_height": 480, "camera_matrix": ROWS}
NERF = {"fl_x": 500, "fl_y": 510, "cx": 321.75, "cy": 239, "w": 640, "h": 480}
RECTIFIED = {"E": np.eye(3), "Q": np.eye(4), "T": [[1.0], [2], [3]], "P1": np.eye(3, 4)}
RIG = {"camera_model_name": "OPENCV", "camera_params": [500, 510, 321.75, 239, *LENS[:4]]}

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

EUROC = (  # The sensor.yaml of EuRoC's sequences, which begins as OpenCV's YAML does.
    "%YAML:1.0\n# General sensor definitions.\nsensor_type: camera\nresolution: [640, 480]\n"
    "camera_model: pinhole\nintrinsics: [500.0, 510.0, 321.25, 238.5] #fu, fv, cu, cv\n"
    f"distortion_model: radial-tangential\ndistortion_coefficients: {LENS[:4]}\n"
)

KITTI_RAW = (
    "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\nS_00: 1.392e+03 5.12e+02\n"
    "K_00: 9.8e+02 0 6.9e+02 0 9.7e+02 2.4e+02 0 0 1\nS_rect_00: 6.400e+02 4.800e+02\n"
    "P_rect_00: 5.0e+02 0 321.25 0 0 5.1e+02 238.5 0 0 0 1 0\n"
)


def ros(model: str, coefficients: list[float]) -> str:
    return ROS.format(model=model, count=len(coefficients), coefficients=coefficients)


# Where it is, what the file holds, and OpenCV's coefficients of the lens. Some state no size.
FORMS: dict[str, tuple[str, Any, list[float]]] = {
    "OpenCV, YAML": ("a.yml", Storage(OPENCV), []),
    "OpenCV, XML": ("a.xml", Storage(OPENCV, distortion_coefficients=[LENS[:4]]), LENS[:4]),
    "OpenCV, JSON": ("a.json", Storage(OPENCV, distortion_coefficients=LENS[:5]), LENS[:5]),
    "OpenCV, 8": ("a.yml", Storage(OPENCV, distortion_coefficients=[LENS]), LENS),
    "OpenCV, 12": ("a.xml", Storage(OPENCV, distortion_coefficients=[*LENS, *4 * [0.0]]), LENS),
    "OpenCV, fisheye": ("a.yml", Storage(OPENCV, fisheye_model=1, D=FISHEYE), FISHEYE),
    "OpenCV, a fisheye that is told": (
        "a.yml:fisheye",
        Storage(image_width=640, image_height=480, cameraMatrix=ROWS, dist_coeffs=FISHEYE),
        FISHEYE,
    ),
    "OpenCV, without a size": ("a.yml", Storage(cameraMatrix=ROWS, dist_coeffs=LENS[:4]), LENS[:4]),
    "ROS": ("ost.yaml", ros("plumb_bob", LENS[:5]), LENS[:5]),
    "ROS, rational": ("ost.yaml", ros("rational_polynomial", LENS), LENS),
    "ROS, fisheye": ("ost.yaml", ros("equidistant", FISHEYE), FISHEYE),
    "ROS, message": ("ost.yaml", MESSAGE, LENS[:5]),
    "Kalibr": ("chain.yaml:cam0", kalibr("radtan", LENS[:4]), LENS[:4]),
    "Kalibr, fisheye": ("chain.yaml:cam0", kalibr("equidistant", FISHEYE), FISHEYE),
    "Kalibr, none": ("chain.yaml:cam0", kalibr("none", []), []),
    "EuRoC": ("sensor.yaml", EUROC, LENS[:4]),
    "stereo, M1, without a size": (
        "a.yml:M1",
        Storage(RECTIFIED, M1=ROWS, D1=[LENS[:4]], M2=OTHER, D2=[LENS[:5]]),
        LENS[:4],
    ),
    "stereo, K2, without a size": (
        "a.yml:K2",
        Storage(RECTIFIED, K1=OTHER, D1=LENS, K2=ROWS, D2=[[0.0]] * 5),
        [],
    ),
    "stereo, cameraMatrix2, without a size": (
        "a.yml:cameraMatrix2",
        Storage(cameraMatrix1=OTHER, distCoeffs1=[0.0] * 4, cameraMatrix2=ROWS, distCoeffs2=LENS),
        LENS,
    ),
    "stereo, plain, fisheye": (
        "a.yaml:K1",
        {"K1": ROWS, "D1": FISHEYE, "K2": OTHER, "D2": 4 * [0.0], "fisheye_model": 1}
        | {"imageSize": SIZE},
        FISHEYE,
    ),
    "EasyMocap": (
        "intri.yml:02",
        Storage(names=["1", "02"], K_1=OTHER, dist_1=LENS, K_02=ROWS, dist_02=[LENS[:5]])
        | {"H_02": 480, "W_02": 640},
        LENS[:5],
    ),
    "anipose": ("a.toml:A", {"cam_0": table(0, name="A"), "cam_1": table(1)}, LENS[:5]),
    "caliscope": ("a.toml:cam_0", {"cameras.0": table(0), "cameras.1": table(1)}, LENS[:5]),
    "Pose2Sim": ("a.toml:a", {"a": table(0, LENS), "metadata": {"adjusted": False}}, LENS),
    "Pose2Sim, fisheye": ("a.toml", {"a": table(0, FISHEYE, fisheye=True)}, FISHEYE),
    "rig_config, without a size": (
        "rig_config.json:left",
        [{"cameras": [{"image_prefix": "rig/left/", **RIG}, {"image_prefix": "rig/right/"}]}],
        LENS[:4],
    ),
    "JSON, rows": ("K.json", {"K": ROWS, "size": SIZE}, []),
    "JSON, nine": ("K.json", {"K": K.ravel().tolist(), "width": 640, "height": 480}, []),
    "JSON, four": ("K.json", {"K": FOUR, "size": SIZE}, []),
    "JSON, names": ("K.json", {**FLAT, "width": 640, "height": 480}, []),
    "JSON, 4 x 4": ("K.json", {"size": SIZE, "K": [*K[0], 0, *K[1], 0, *K[2], 0, 0, 0, 0, 1]}, []),
    "JSON of estimate": ("K.json", camera_data(Camera(K, SIZE)), []),
    "JSON of a pair": ("K.json:K2", {"K1": OTHER, "K2": {"K": ROWS, "size": SIZE}}, []),
    "Open3D": ("K.json", {"width": 640, "height": 480, "intrinsic_matrix": BY_COLUMNS}, []),
    "Record3D": ("K.json", {"w": 640, "h": 480, "K": BY_COLUMNS, "fps": 60, "poses": [[0]]}, []),
    "table": ("K.csv", "name,fx,fy,cx,cy,width,height\na.png,500,510,321.25,238.5,640,480\n", []),
    "KITTI's odometry, without a size": ("P.txt", "P0: 500 0 321.25 0 0 510 238.5 0 0 0 1 0", []),
    "KITTI's raw drives": ("calib_cam_to_cam.txt:image_0", KITTI_RAW, []),
    "NeRF": ("t.json", {**NERF, "frames": [{"file_path": "./images/a.png"}]}, []),
    "NeRF, frame": ("t.json", {"frames": [{"file_path": "images/a", **NERF}]}, []),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_camera_in_each_form(tmp_path: Path, form: str) -> None:
    """An image is named a.png."""
    place, content, lens = FORMS[form]
    name, colon, part = place.partition(":")
    path = write_file(tmp_path / name, content)
    calibration = read_calibration(f"{path}{colon}{part}")
    camera = calibration.stated(Path("images"), "a.png", "K1")
    assert camera is not None
    np.testing.assert_array_equal(camera.K, K)
    assert_lens(camera, lens or 4 * [0.0], is_fisheye="fisheye" in form)
    assert camera.size == (None if "without a size" in form else SIZE)
    assert camera.warnings == ()
    if form.startswith("NeRF"):
        assert (camera.identity is None) == (form == "NeRF, frame")


@pytest.mark.parametrize("name", ["K.txt", "K.csv", "k.mat"])
def test_numbers_split_by_commas_or_blanks(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for values in (FOUR, K.ravel().tolist()):
        words = [*map(str, values)]
        for text in map(str.join, (",", " ", " ,", "0" * 80 + ","), 4 * [words]):
            path.write_text(f"# of the left camera\n{text}\n\n")
            for source in (text, str(path)):
                np.testing.assert_array_equal(parse_camera(source).K, K)
    np.save(tmp_path / "K.npy", K)
    np.testing.assert_array_equal(parse_camera(str(tmp_path / "K.npy")).K, K)


def test_kalibrs_fov_is_colmaps(tmp_path: Path) -> None:
    """As Kalibr's by Devernay and Faugeras."""
    path = write_file(tmp_path / "chain.yaml", kalibr("fov", [0.8]))
    assert parse_camera(f"{path}:cam0").distortion == Distortion("FOV", (0.8,))


@pytest.mark.parametrize(
    ("own", "focals"),
    [
        ({"camera_angle_x": 2 * math.atan(0.5)}, [640, 640]),
        ({"camera_angle_x": 2 * math.atan(0.5), "camera_angle_y": 2 * math.atan(0.4)}, [640, 600]),
        ({"camera_angle_x": 2 * math.atan(0.5), "fl_y": 600}, [640, 600]),
        ({"fl_x": 700, "fl_y": 710}, [700, 710]),
        ({"cx": 320.5}, [500, 510]),
    ],
)
@pytest.mark.parametrize("common", [{}, {"camera_angle_x": 1.0, "camera_angle_y": 0.8}])
def test_focal_lengths_of_a_frame(
    tmp_path: Path, own: dict[str, float], focals: list[float], common: dict[str, float]
) -> None:
    data = {**NERF, **common, "frames": [{"file_path": "a", **own}]}
    path = write_file(tmp_path / "transforms.json", data)
    camera = read_calibration(path).stated(tmp_path, "a.jpg")
    assert camera is not None
    np.testing.assert_allclose(camera.K.diagonal()[:2], focals)


@pytest.mark.parametrize(
    ("own", "model"),
    [
        ({}, "OPENCV_FISHEYE"),
        ({"is_fisheye": False}, "OPENCV"),
        ({"camera_model": "OPENCV"}, "OPENCV"),
    ],
)
def test_the_lens_of_a_frame_whose_model_is_another(
    tmp_path: Path, own: dict[str, Any], model: str
) -> None:
    data = {**NERF, "is_fisheye": True, "k1": 0.1, "frames": [{"file_path": "a", **own}]}
    path = write_file(tmp_path / "transforms.json", data)
    camera = read_calibration(path).stated(tmp_path, "a.jpg")
    assert camera is not None and camera.distortion is not None
    assert camera.distortion.model == model
