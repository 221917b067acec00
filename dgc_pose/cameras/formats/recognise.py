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
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dgc_pose.cameras.formats import colmap, keyed, kitti, nerf, plain
from dgc_pose.cameras.formats.file_cameras import FileCameras, numbers_camera
from dgc_pose.errors import InputError, shortened
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.files.yaml_files import yaml_data

_MAX_NUMBERS = 4096  # characters of a file with nine numbers
_COLMAP = ("cameras.txt", "cameras.bin")


def read_file(path: Path, name: str) -> FileCameras:
    """The cameras of a file, or of the folder of a COLMAP model.

    Raises InputError, with the path or the option `name`; OSError if a file cannot be read.
    """
    if path.is_dir():
        return colmap.read_model(path, name)
    try:
        return _read_file(path)
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {error}") from error


def _read_file(path: Path) -> FileCameras:
    ending = path.suffix.lower()
    if ending == ".npy":
        return plain.read_npy(path)
    if ending == ".bin" or path.name.lower() in _COLMAP:
        return colmap.read_cameras(path)
    text = read_text(path, "a file of cameras")
    if not text.strip():
        raise InputError(f"{path} is empty")
    if "<opencv_storage>" in text:
        with read_as("XML", path):
            return _of_mapping(keyed.xml_data(ElementTree.fromstring(text)), path)
    if ending == ".json" or text.lstrip().startswith("{"):
        with read_as("JSON", path):
            return _of_mapping(json.loads(text), path)
    if ending in (".yaml", ".yml") or text.startswith("%YAML"):
        return _of_mapping(yaml_data(text, path), path)
    if kitti.is_kitti(text):
        return kitti.read_kitti(text, path)
    lines = [line.split("#")[0] for line in text.splitlines()]
    lines = [line for line in lines if line.strip()]
    if lines and colmap.is_line(lines[0]):
        if lines[0].split()[0].isdecimal():
            return colmap.read_cameras(path)
        if len(lines) == 1:
            return FileCameras(common=colmap.parse_line(lines[0]))
    return _of_numbers(text, lines, path)


def _of_mapping(data: Any, path: Path) -> FileCameras:
    """The cameras of what JSON, YAML or XML holds."""
    with read_as("a file of cameras", path):
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


def _of_numbers(text: str, lines: list[str], path: Path) -> FileCameras:
    numbers = plain.numbers_of("\n".join(lines)) if len(text) <= _MAX_NUMBERS else None
    if numbers is not None:
        return FileCameras(common=numbers_camera(numbers))
    if path.suffix.lower() == ".csv":
        return plain.read_table(text, path)
    raise InputError(
        "no 3x3 matrix, no fx fy cx cy, and no other file of cameras "
        f"(it begins with {shortened(lines[0].strip() if lines else '')!r})"
    )
