"""Files of cameras as other programs write them, and OpenCV's lenses."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera

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


def kalibr(model: str, coefficients: list[float]) -> str:
    return KALIBR.format(model=model, coefficients=coefficients)


def table(number: int, lens: Any = LENS[:5], **others: Any) -> dict[str, Any]:
    """A camera in a TOML of anipose, caliscope or Pose2Sim, with its own focal length."""
    matrix = [[500.0 + number, 0, 321.25], *ROWS[1:]]
    pose = {"rotation": [0.1, 0.2, 0.3], "translation": [1.0, 2.0, 3.0]}
    return {"size": SIZE, "matrix": matrix, "distortions": lens, **pose, "error": 0.3, **others}


def write_file(path: Path, content: Any) -> str:
    """Write a text, a Storage, or else the tables of a TOML or JSON; the ending tells which.
    Returns the path."""
    if isinstance(content, Storage):
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
    points, lens = camera.normalise(pixels), np.array(coefficients, np.float64)
    if is_fisheye:
        again = cv2.fisheye.distortPoints(points[:, None], camera.K, lens)
    else:
        rays = np.column_stack([points, np.ones(len(points))])
        again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, lens)
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-3)
