"""Recognise the format of a camera file, by its content and, if that is ambiguous, by its name.

docs/cameras.md lists the formats. The centre of the top-left pixel is (0.5, 0.5) in files of COLMAP
and NeRF, and (0, 0) in all others, as in `Camera`. COLMAP's models, NeRF's transforms.json,
Record3D's metadata and tables have cameras by image name; rig files have them by camera name.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats import colmap, keyed, rigs
from dgc_pose.cameras.formats.keyed import numbers, numbers_camera
from dgc_pose.errors import InputError, shortened
from dgc_pose.system.arrays import read_array
from dgc_pose.system.files import read_as, read_text
from dgc_pose.system.texts import toml_data, yaml_data

# KITTI's projections P describe the rectified images in its folders; S, K and D do not.
_PROJECTION = re.compile(r"^P(?:_rect_)?(\d+):(.*)", re.MULTILINE)
_SIZE = re.compile(r"^S_rect_(\d+):\s*(\S+)\s+(\S+)", re.MULTILINE)
_OTHERS = re.compile(r"^(?!(?:P\d+|[SKD]_\d+|corner_dist):)(\w+):(.*)", re.MULTILINE)
# If a NeRF frame has one key of a group, it replaces the whole group of the file.
_GROUPS = (("fl_x", "fl_y", "camera_angle_x", "camera_angle_y"), ("camera_model", "is_fisheye"))


def read_file(path: Path) -> Calibration:
    """Read the cameras of a file, or of the folder of a COLMAP model.

    Raises InputError, with the path; OSError if a file cannot be read.
    """
    try:
        with read_as("a file of cameras", path):
            return replace(_read_file(path), where=str(path))
    except InputError as error:
        if error.path is not None:
            raise
        raise InputError(f"{path}: {error}") from error


def _read_file(path: Path) -> Calibration:
    ending = path.suffix.lower()
    if path.is_dir():
        return colmap.read_model(path)[0]
    if ending == ".npy":
        return Calibration(common=numbers_camera(read_array(path)))
    if ending == ".bin":
        return colmap.read_model(path)[0]
    text = read_text(path, "a file of cameras")
    if not text.strip():
        raise InputError(path, "is empty")
    if ending == ".toml":
        return _of_mapping(toml_data(text, path), path)
    if "<opencv_storage>" in text:
        return _of_mapping(keyed.xml_data(ElementTree.fromstring(text)), path)
    if ending == ".json" or text.lstrip().startswith("{"):
        return _of_mapping(json.loads(text), path)
    if ending in (".yaml", ".yml") or text.startswith("%YAML"):
        return _of_mapping(yaml_data(text, path), path)
    if _PROJECTION.search(text) and (rig := _kitti_cameras(text, path)) is not None:
        return rig
    lines = [line.split("#")[0] for line in text.splitlines()]
    lines = [line for line in lines if line.strip()] or [""]
    if colmap.is_line(lines[0]):
        if lines[0].split()[0].isdecimal():
            return colmap.read_model(path)[0]
        if len(lines) == 1:
            return Calibration(common=colmap.parse_line(lines[0]))
    if ending == ".csv" and numbers(lines[0]) is None:
        return keyed.read_table(text, path)
    if (values := numbers(" ".join(lines))) is not None:
        return Calibration(common=numbers_camera(values))
    raise InputError(
        "no 3x3 matrix, no fx fy cx cy, and no other file of cameras "
        f"(it begins with {shortened(lines[0].strip())!r})"
    )


def _of_mapping(data: Any, path: Path) -> Calibration:
    if isinstance(data, list) and (rig := rigs.colmap_rig(data, path)) is not None:
        return rig
    if not isinstance(data, dict):
        return Calibration(common=numbers_camera(data))
    if not {"frames", "fl_x", "camera_angle_x"}.isdisjoint(data):
        return _nerf_cameras(data, str(path))
    if data.get("calibration") == rigs.CALIBRATION:  # rig.json
        return _read_file(path.with_name(rigs.CALIBRATION))
    return rigs.named_rig(data, path) or keyed.keyed_cameras(data)


def _kitti_cameras(text: str, path: Path) -> Calibration | None:
    """The cameras "image_0", "image_1", ... from KITTI's calib.txt (odometry, objects) or
    calib_cam_to_cam.txt (raw drives)."""
    others = dict.fromkeys(keyed.unread(dict(_OTHERS.findall(text))), "unread")
    sizes = {key: (width, height) for key, width, height in _SIZE.findall(text)}
    tables = {}
    for key, values in _PROJECTION.findall(text):
        P = np.array(values.split(), dtype=np.float64).reshape(3, 4)
        table = {"matrix": P[:, :3].tolist(), "size": sizes.get(key)}
        tables[f"image_{int(key)}"] = others | table
    return rigs.calibration(tables, path)


def _nerf_cameras(data: Mapping[str, Any], where: str) -> Calibration:
    """The cameras of a transforms.json by the names of its frames, which may lack an ending.

    where: the path, for the identity of the cameras. Raises InputError, KeyError, TypeError,
    AttributeError, ValueError or ArithmeticError for other data.
    """
    shared = {key: value for key, value in data.items() if key != "frames"}
    common = _nerf_camera(shared)
    if common is not None:
        common = replace(common, identity=where)
    by_name = {}
    poses = {}
    for frame in data.get("frames", ()):
        name = str(frame["file_path"])
        if "transform_matrix" in frame:  # world_from_cam, axes right, up, backwards
            matrix = np.linalg.inv(np.array(frame["transform_matrix"], dtype=np.float64))
            poses[name] = (matrix * [[1], [-1], [-1], [1]])[:3]
        replaced = {key for keys in _GROUPS if not frame.keys().isdisjoint(keys) for key in keys}
        rest = {key: value for key, value in shared.items() if key not in replaced}
        camera = _nerf_camera({**rest, **frame})
        if camera is None and common is not None:
            raise InputError(f"{name} has neither fl_x nor camera_angle_x with w")
        if camera is not None:
            is_common = common is not None and _facts(camera) == _facts(common)
            by_name[name] = common if common is not None and is_common else camera
    if common is None and not by_name:
        raise InputError("has neither fl_x nor camera_angle_x with w")
    return Calibration("", by_name, common=common, poses=poses)


def _facts(camera: Camera) -> tuple[Any, ...]:
    return camera.K.tolist(), camera.size, camera.distortion, camera.warnings


def _nerf_camera(data: Mapping[str, Any]) -> Camera | None:
    width = data.get("w")
    height = data.get("h")
    size = None if width is None or height is None else (int(width), int(height))
    fx, fy = (_focal(data, axis, size and size[side]) for side, axis in enumerate("xy"))
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        return None
    if size is None and not ("cx" in data and "cy" in data):
        raise InputError("neither cx and cy nor w and h")
    middle = (size[0] / 2, size[1] / 2) if size else (0, 0)
    cx, cy = (float(data.get(key, middle[axis])) - 0.5 for axis, key in enumerate(("cx", "cy")))
    camera = keyed.keyed_camera({**keyed.of_camera(data), "K": [fx, fy, cx, cy]}, "K")
    return replace(camera, size=size)


def _focal(data: Mapping[str, Any], axis: str, side: int | None) -> float | None:
    """The focal length along an axis, pixels. side: of the image along this axis, pixels."""
    if data.get(f"fl_{axis}") is not None:
        return float(data[f"fl_{axis}"])
    angle = data.get(f"camera_angle_{axis}")
    return None if angle is None or side is None else side / 2 / math.tan(float(angle) / 2)
