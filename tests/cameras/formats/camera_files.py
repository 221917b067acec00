"""One camera in every form that is read, as other programs write it, and OpenCV's lenses."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.calibration import camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.rigs import CALIBRATION

SIZE = (640, 480)
K = np.array([[500.0, 0, 321.25], [0, 510, 238.5], [0, 0, 1]])
ROWS = K.tolist()
LENS = [-0.21, 0.06, 0.002, -0.001, 0.013, 0.02, 0.01, 0.004]  # as OpenCV orders them
FISHEYE = [-0.03, 0.005, -0.001, 0.0002]

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


class Storage(dict[str, Any]):
    """What a cv::FileStorage holds."""


class Files(dict[str, Any]):
    """A file and the others beside it, by name."""


def kalibr(model: str, coefficients: list[float]) -> str:
    return KALIBR.format(model=model, coefficients=coefficients)


def table(number: int, lens: Any = LENS[:5], **others: Any) -> dict[str, Any]:
    """A camera in a TOML of anipose, caliscope or Pose2Sim, with its own focal length."""
    matrix = [[500.0 + number, 0, 321.25], *ROWS[1:]]
    pose = {"rotation": [0.1, 0.2, 0.3], "translation": [1.0, 2.0, 3.0]}
    return {"size": SIZE, "matrix": matrix, "distortions": lens, **pose, "error": 0.3, **others}


FOUR = [500.0, 510.0, 321.25, 238.5]
COLMAP = [500, 510, 321.75, 239, *LENS[:4]]
FLAT = {"fx": 500, "fy": 510, "cx": 321.25, "cy": 238.5}
OTHER = [[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]  # of a second camera
BY_COLUMNS = K.T.ravel().tolist()
OPENCV = {"image_width": 640, "image_height": 480, "camera_matrix": ROWS}
NERF = {"fl_x": 500, "fl_y": 510, "cx": 321.75, "cy": 239, "w": 640, "h": 480}
POSED = {"transform_matrix": np.eye(4).tolist()}
RECTIFIED = {"E": np.eye(3), "Q": np.eye(4), "T": [[1.0], [2], [3]], "P1": np.eye(3, 4)}
RIG = {"camera_model_name": "OPENCV", "camera_params": COLMAP}

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


def _words(values: list[float]) -> str:
    return " ".join(map(str, values))


def ros(model: str, coefficients: list[float]) -> str:
    return ROS.format(model=model, count=len(coefficients), coefficients=coefficients)


# By the example of a row of `recognise.FORMATS`: where the camera is, what the file holds, and
# OpenCV's coefficients of the lens. Some state no size. The x of the principal point is 321.25, and
# half a pixel more where the centre of the top-left pixel is (0.5, 0.5).
Form = tuple[str, Any, list[float]]
FORMS_BY_FORMAT: dict[str, dict[str, Form]] = {
    "sparse/0": {
        "COLMAP": ("cameras.txt", f"1 OPENCV 640 480 {_words(COLMAP)}\n", LENS[:4]),
        "COLMAP, a line": ("camera.txt", f"OPENCV 640 480 {_words(COLMAP)}\n", LENS[:4]),
    },
    "rig_config.json:cam_1": {
        "rig_config, without a size": (
            "rig_config.json:left",
            [{"cameras": [{"image_prefix": "rig/left/", **RIG}, {"image_prefix": "rig/right/"}]}],
            LENS[:4],
        ),
    },
    "transforms.json": {
        "NeRF": ("t.json", {**NERF, "frames": [{**POSED, "file_path": "./images/a.png"}]}, []),
        "NeRF, frame": ("t.json", {"frames": [{"file_path": "images/a", **NERF}]}, []),
    },
    "rig.json:cam_1": {
        "rig.json": (
            "rig.json:A",
            Files(
                {
                    "rig.json": {"calibration": CALIBRATION},
                    CALIBRATION: {"cam_0": table(0, name="A")},
                }
            ),
            LENS[:5],
        ),
    },
    "camchain.yaml:cam1": {
        "Kalibr": ("chain.yaml:cam0", kalibr("radtan", LENS[:4]), LENS[:4]),
        "Kalibr, fisheye": ("chain.yaml:cam0", kalibr("equidistant", FISHEYE), FISHEYE),
        "Kalibr, none": ("chain.yaml:cam0", kalibr("none", []), []),
        "EuRoC": ("sensor.yaml", EUROC, LENS[:4]),
    },
    "camera_array.toml:cam_1": {
        "anipose": ("a.toml:A", {"cam_0": table(0, name="A"), "cam_1": table(1)}, LENS[:5]),
        "caliscope": ("a.toml:cam_0", {"cameras.0": table(0), "cameras.1": table(1)}, LENS[:5]),
        "Pose2Sim": ("a.toml:a", {"a": table(0, LENS), "metadata": {"adjusted": False}}, LENS),
        "Pose2Sim, fisheye": ("a.toml", {"a": table(0, FISHEYE, fisheye=True)}, FISHEYE),
    },
    "intri.yml:01": {
        "EasyMocap": (
            "intri.yml:02",
            Storage(names=["1", "02"], K_1=OTHER, dist_1=LENS, K_02=ROWS, dist_02=[LENS[:5]])
            | {"H_02": 480, "W_02": 640},
            LENS[:5],
        ),
    },
    "stereo.yml:M2": {
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
            Storage(
                cameraMatrix1=OTHER, distCoeffs1=[0.0] * 4, cameraMatrix2=ROWS, distCoeffs2=LENS
            ),
            LENS,
        ),
        "stereo, plain, fisheye": (
            "a.yaml:K1",
            {"K1": ROWS, "D1": FISHEYE, "K2": OTHER, "D2": 4 * [0.0], "fisheye_model": 1}
            | {"imageSize": SIZE},
            FISHEYE,
        ),
    },
    "camera.yml": {
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
        "OpenCV, without a size": (
            "a.yml",
            Storage(cameraMatrix=ROWS, dist_coeffs=LENS[:4]),
            LENS[:4],
        ),
    },
    "ost.yaml": {
        "ROS": ("ost.yaml", ros("plumb_bob", LENS[:5]), LENS[:5]),
        "ROS, rational": ("ost.yaml", ros("rational_polynomial", LENS), LENS),
        "ROS, fisheye": ("ost.yaml", ros("equidistant", FISHEYE), FISHEYE),
        "ROS, message": ("ost.yaml", MESSAGE, LENS[:5]),
    },
    "metadata.json": {
        "Open3D": ("K.json", {"width": 640, "height": 480, "intrinsic_matrix": BY_COLUMNS}, []),
        "Record3D": (
            "K.json",
            {"w": 640, "h": 480, "K": BY_COLUMNS, "fps": 60, "poses": [[0]]},
            [],
        ),
    },
    "pose.json": {
        "JSON, rows": ("K.json", {"K": ROWS, "size": SIZE}, []),
        "JSON, nine": ("K.json", {"K": K.ravel().tolist(), "width": 640, "height": 480}, []),
        "JSON, four": ("K.json", {"K": FOUR, "size": SIZE}, []),
        "JSON, names": ("K.json", {**FLAT, "width": 640, "height": 480}, []),
        "JSON, 4 x 4": (
            "K.json",
            {"size": SIZE, "K": [*K[0], 0, *K[1], 0, *K[2], 0, 0, 0, 0, 1]},
            [],
        ),
        "JSON of estimate": ("K.json", camera_data(Camera(K, SIZE)), []),
        "JSON of a pair": ("K.json:K2", {"K1": OTHER, "K2": {"K": ROWS, "size": SIZE}}, []),
    },
    "calib.txt:image_2": {
        "KITTI's odometry, without a size": (
            "P.txt",
            "P0: 500 0 321.25 0 0 510 238.5 0 0 0 1 0",
            [],
        ),
        "KITTI's raw drives": ("calib_cam_to_cam.txt:image_0", KITTI_RAW, []),
    },
    "cameras.csv": {
        "table": (
            "K.csv",
            "name,fx,fy,cx,cy,width,height\na.png,500,510,321.25,238.5,640,480\n",
            [],
        ),
    },
    "K.txt": {
        "matrix, without a size": ("K.txt", "500 0 321.25\n0 510 238.5\n0 0 1\n", []),
    },
}
FORMS = {name: form for forms in FORMS_BY_FORMAT.values() for name, form in forms.items()}


def write_file(path: Path, content: Any) -> str:
    """Write a text, a Storage, Files, or else the tables of a TOML or JSON; the ending tells which.
    Returns the path."""
    if isinstance(content, Files):
        for name, own in content.items():
            write_file(path.with_name(name), own)
    elif isinstance(content, Storage):
        _write_storage(path, content)
    elif isinstance(content, str):
        path.write_text(content)
    elif path.suffix == ".toml":  # whose simple values are those of JSON
        lines = ["CreationDate = 2023-05-06T11:12:27.631355"]
        for name, values in content.items():
            lines.append(f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
        text = "\n".join([*lines, ""])
        path.write_text(text.replace("NaN", "nan").replace("Infinity", "inf"))
    else:
        path.write_text(json.dumps(content))
    return str(path)


def _write_storage(path: Path, values: Storage) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if name == "names":
            storage.startWriteStruct(name, cv2.FileNode_SEQ)
            for text in value:
                storage.write("", text)
            storage.endWriteStruct()
        else:
            storage.write(name, value if isinstance(value, int) else np.array(value))
    storage.release()


def assert_lens(camera: Camera, coefficients: Any, is_fisheye: bool = False) -> None:
    """OpenCV projects the camera's rays back onto the pixels."""
    pixels = np.random.default_rng(0).uniform((100, 80), (540, 400), (30, 2))
    points = camera.normalise(pixels)
    lens = np.array(coefficients, np.float64)
    if is_fisheye:
        again = cv2.fisheye.distortPoints(points[:, None], camera.K, lens)
    else:
        rays = np.column_stack([points, np.ones(len(points))])
        again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, lens)
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-3)
