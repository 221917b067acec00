"""The format of a file of cameras, by its content, and by its name where the content is not enough.

| file | principal point of the top-left pixel's centre | images by |
|---|---|---|
| COLMAP's cameras.txt, cameras.bin, folder of a model | (0.5, 0.5) | name, if images.* is there |
| `[id] MODEL width height parameters...`, COLMAP's line | (0.5, 0.5) | - |
| NeRF's transforms.json | (0.5, 0.5) | name |
| OpenCV's cv::FileStorage, YAML, XML or JSON | (0, 0) | - |
| ROS's camera_info, YAML | (0, 0) | - |
| Kalibr's camchain, YAML | (0, 0) | folder `cam0`, `cam1`, ... |
| KITTI's calib.txt, calib_cam_to_cam.txt | (0, 0) | folder `image_0`, `image_02`, ... |
| .csv with name, fx, fy, cx, cy[, width, height, k1, k2, p1, p2] | (0, 0) | name |
| JSON with K, or fx, fy, cx, cy; or with K1 and K2 | (0, 0) | image 1 or 2 of a pair |
| 3x3, or fx fy cx cy, as text or .npy | (0, 0) | - |

`Camera` has (0, 0) there.
"""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats import colmap, keyed, nerf
from dgc_pose.cameras.formats.file_cameras import FileCameras, numbers, numbers_camera, rig
from dgc_pose.errors import InputError, shortened
from dgc_pose.files.arrays import read_array
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.files.yaml_files import yaml_data

_COLMAP = ("cameras.txt", "cameras.bin")
# KITTI's projections P are of the rectified images, which its folders hold; S, K, D are not.
_PROJECTION = re.compile(r"^P(?:_rect_)?(\d+):(.*)", re.MULTILINE)
_SIZE = re.compile(r"^S_rect_(\d+):\s*(\S+)\s+(\S+)", re.MULTILINE)
_OTHERS = re.compile(r"^(?!(?:P\d+|[SKD]_\d+|corner_dist):)(\w+):(.*)", re.MULTILINE)


def read_file(path: Path) -> FileCameras:
    """The cameras of a file, or of the folder of a COLMAP model.

    Raises InputError, with the path; OSError if a file cannot be read.
    """
    if path.is_dir():
        return colmap.read_model(path)
    try:
        with read_as("a file of cameras", path):
            return _read_file(path)
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {error}") from error


def _read_file(path: Path) -> FileCameras:
    ending = path.suffix.lower()
    if ending == ".npy":
        return FileCameras(common=numbers_camera(read_array(path)))
    if ending == ".bin" or path.name.lower() in _COLMAP:
        return colmap.read_cameras(path)
    text = read_text(path, "a file of cameras")
    if not text.strip():
        raise InputError(f"{path} is empty")
    if "<opencv_storage>" in text:
        return _of_mapping(keyed.xml_data(ElementTree.fromstring(text)), path)
    if ending == ".json" or text.lstrip().startswith("{"):
        return _of_mapping(json.loads(text), path)
    if ending in (".yaml", ".yml") or text.startswith("%YAML"):
        return _of_mapping(yaml_data(text, path), path)
    if _PROJECTION.search(text):
        return _kitti_cameras(text, path)
    lines = [line.split("#")[0] for line in text.splitlines()]
    lines = [line for line in lines if line.strip()] or [""]
    if colmap.is_line(lines[0]):
        if lines[0].split()[0].isdecimal():
            return colmap.read_cameras(path)
        if len(lines) == 1:
            return FileCameras(common=colmap.parse_line(lines[0]))
    if ending == ".csv" and numbers(lines[0]) is None:
        return keyed.read_table(text, path)
    if (values := numbers(" ".join(lines))) is not None:
        return FileCameras(common=numbers_camera(values))
    raise InputError(
        "no 3x3 matrix, no fx fy cx cy, and no other file of cameras "
        f"(it begins with {shortened(lines[0].strip())!r})"
    )


def _of_mapping(data: Any, path: Path) -> FileCameras:
    """The cameras of what JSON, YAML or XML holds."""
    if not isinstance(data, dict):
        return FileCameras(common=numbers_camera(data))
    if keyed.is_camera_info(data) and "intrinsics" not in data:
        return keyed.keyed_cameras(data)
    if keyed.camchain_cameras(data):
        return keyed.camchain(data, path)
    if nerf.is_transforms(data):
        return nerf.transforms(data, str(path))
    if keyed.is_keyed(data):
        return keyed.keyed_cameras(data)
    raise InputError(
        f"no camera of OpenCV's, ROS's, Kalibr's or NeRF's and no K among its keys "
        f"({shortened(', '.join(map(str, data)))})"
    )


def _kitti_cameras(text: str, path: Path) -> FileCameras:
    """The cameras "image_0", "image_1", ... of a calib.txt of odometry and objects, or of a
    calib_cam_to_cam.txt of raw drives."""
    keyed.require_read({match[1]: match[2] for match in _OTHERS.finditer(text)})
    sizes = {
        match[1]: (int(float(match[2])), int(float(match[3]))) for match in _SIZE.finditer(text)
    }
    parts = {}
    for match in _PROJECTION.finditer(text):
        P = np.array(match[2].split(), dtype=np.float64).reshape(3, 4)
        parts[f"image_{int(match[1])}"] = Camera(P[:, :3], sizes.get(match[1]))
    return rig(parts, path, {})
