"""NeRF's transforms.json, by instant-ngp and nerfstudio.

The centre of the top-left pixel is (0.5, 0.5), as in COLMAP.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import camera_keys, keyed_camera
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.errors import InputError

_KEYS = {"frames", "fl_x", "camera_angle_x"}
# If a frame has one key of a group, it replaces the whole group of the file.
_GROUPS = (("fl_x", "fl_y", "camera_angle_x", "camera_angle_y"), ("camera_model", "is_fisheye"))


def read(file: CameraFile) -> Calibration | None:
    """The cameras by the names of the frames, which may lack an ending; None for a file without
    frames and focal length.

    Raises InputError, KeyError, TypeError, AttributeError, ValueError or ArithmeticError for
    other data.
    """
    data = file.data
    if not isinstance(data, Mapping) or _KEYS.isdisjoint(data):
        return None

    shared = {key: value for key, value in data.items() if key != "frames"}
    common = _camera(shared)
    if common is not None:
        common = replace(common, identity=str(file.path))

    by_name = {}
    poses = {}
    for frame in data.get("frames", ()):
        name = str(frame["file_path"])
        if "transform_matrix" in frame:  # world_from_cam, axes right, up, backwards
            matrix = np.linalg.inv(np.array(frame["transform_matrix"], dtype=np.float64))
            poses[name] = (matrix * [[1], [-1], [-1], [1]])[:3]
        replaced = {key for keys in _GROUPS if not frame.keys().isdisjoint(keys) for key in keys}
        rest = {key: value for key, value in shared.items() if key not in replaced}
        camera = _camera({**rest, **frame})
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


def _camera(data: Mapping[str, Any]) -> Camera | None:
    width = data.get("w")
    height = data.get("h")
    size = None if width is None or height is None else (int(width), int(height))
    along_x, along_y = (_focal(data, axis, size and size[side]) for side, axis in enumerate("xy"))
    fx = along_x or along_y
    fy = along_y or along_x
    if fx is None or fy is None:
        return None

    if size is None and not ("cx" in data and "cy" in data):
        raise InputError("neither cx and cy nor w and h")
    middle = (size[0] / 2, size[1] / 2) if size else (0, 0)
    cx, cy = (float(data.get(key, middle[axis])) - 0.5 for axis, key in enumerate(("cx", "cy")))
    camera = keyed_camera({**camera_keys(data), "K": [fx, fy, cx, cy]}, "K")
    return replace(camera, size=size)


def _focal(data: Mapping[str, Any], axis: str, side: int | None) -> float | None:
    """The focal length along an axis, pixels. side: of the image along this axis, pixels."""
    if data.get(f"fl_{axis}") is not None:
        return float(data[f"fl_{axis}"])
    angle = data.get(f"camera_angle_{axis}")
    return None if angle is None or side is None else side / 2 / math.tan(float(angle) / 2)
