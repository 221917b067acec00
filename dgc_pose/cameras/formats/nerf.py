"""NeRF's transforms.json, of instant-ngp and nerfstudio: intrinsics for all or for each frame.

The principal point has (0.5, 0.5) at the centre of the top-left pixel, as COLMAP's, of which these
files are made.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.file_cameras import FileCameras, matrix
from dgc_pose.cameras.formats.keyed import file_lens, may_matter
from dgc_pose.errors import InputError

_INTRINSIC_KEYS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "cx", "cy", "w", "h")
# Where a frame has one key of a group, the file's values for that group do not hold for it.
_GROUPS = (_INTRINSIC_KEYS[:4], ("camera_model", "is_fisheye"))


def is_transforms(data: Mapping[str, Any]) -> bool:
    """Whether this is a transforms.json."""
    return not {"frames", "fl_x", "camera_angle_x"}.isdisjoint(data)


def transforms(data: Mapping[str, Any], where: str) -> FileCameras:
    """The cameras of a transforms.json by the names of its frames, which may lack their ending.

    where: the path, for the identity of the cameras. Raises InputError, KeyError, TypeError,
    AttributeError, ValueError or ArithmeticError for what is none.
    """
    common = _camera(data)
    if common is not None:
        common = replace(common, identity=where)
    by_name = {}
    for frame in data.get("frames", ()):
        of_frame = {k: v for k, v in frame.items() if k in _INTRINSIC_KEYS or may_matter(k)}
        replaced = {key for keys in _GROUPS if not of_frame.keys().isdisjoint(keys) for key in keys}
        rest = {key: value for key, value in data.items() if key not in replaced}
        camera = common if not of_frame else _camera({**rest, **of_frame})
        if camera is not None:
            by_name[str(frame["file_path"])] = camera
        elif common is not None:
            raise InputError(f"{frame['file_path']} has no fl_x, and no camera_angle_x with w")
    if common is None and not by_name:
        raise InputError("no fl_x, and no camera_angle_x with w, in this transforms.json")
    return FileCameras(by_name, common=common)


def _camera(data: Mapping[str, Any]) -> Camera | None:
    """Intrinsics of a file or frame."""
    width, height = data.get("w"), data.get("h")
    size = None if width is None or height is None else (int(width), int(height))
    fx, fy = (_focal(data, axis, size and size[side]) for side, axis in enumerate("xy"))
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        return None
    if size is None and not ("cx" in data and "cy" in data):
        raise InputError("neither cx and cy nor w and h")
    middle = (size[0] / 2, size[1] / 2) if size else (0, 0)
    cx, cy = (float(data.get(key, middle[axis])) - 0.5 for axis, key in enumerate(("cx", "cy")))
    return Camera(matrix(fx, fy, cx, cy), size, file_lens(data))


def _focal(data: Mapping[str, Any], axis: str, side: int | None) -> float | None:
    """The focal length along an axis, pixels; side: of the image."""
    if data.get(f"fl_{axis}") is not None:
        return float(data[f"fl_{axis}"])
    angle = data.get(f"camera_angle_{axis}")
    return None if angle is None or side is None else side / 2 / math.tan(float(angle) / 2)
