"""NeRF's transforms.json, of instant-ngp and nerfstudio: intrinsics for all or for each frame.

The principal point has (0.5, 0.5) at the centre of the top-left pixel, as COLMAP's, of which these
files are made.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import FileCameras, fisheye_lens, matrix, opencv_lens
from dgc_pose.errors import InputError, reason

_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


def is_transforms(data: Mapping[str, Any]) -> bool:
    """Whether this is a transforms.json."""
    return not {"frames", "fl_x", "camera_angle_x"}.isdisjoint(data)


def transforms(data: Mapping[str, Any], where: str) -> FileCameras:
    """The cameras of a transforms.json by the names of its frames, which may lack their ending.

    where: the path, for the identity of the cameras. Raises InputError.
    """
    try:
        common = _camera(data)
        if common is not None:
            common = replace(common, identity=where)
        by_name = {}
        for frame in data.get("frames", ()):
            own = {key: value for key, value in frame.items() if key in _KEYS}
            camera = common if not own else _camera({**data, **own})
            if camera is not None:
                by_name[str(frame["file_path"])] = camera
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(f"not a transforms.json ({reason(error)})") from None
    if common is None and not by_name:
        raise InputError("no fl_x, and no camera_angle_x with w, in this transforms.json")
    return FileCameras(by_name, common=common)


_RADIAL, _TANGENTIAL = ("k1", "k2", "k3", "k4"), ("p1", "p2")
_KEYS = (
    *_RADIAL,
    *_TANGENTIAL,
    *("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x", "camera_angle_y"),
    *("camera_model", "is_fisheye"),
)


def _camera(data: Mapping[str, Any]) -> Camera | None:
    """Intrinsics of a file or frame."""
    width, height = data.get("w"), data.get("h")
    size = None if width is None or height is None else (int(width), int(height))
    fx, fy = data.get("fl_x"), data.get("fl_y")
    if fx is None and size is not None and "camera_angle_x" in data:
        fx = size[0] / 2 / math.tan(float(data["camera_angle_x"]) / 2)
        if fy is None and "camera_angle_y" in data:
            fy = size[1] / 2 / math.tan(float(data["camera_angle_y"]) / 2)
    if fx is None:
        return None
    if size is None and not ("cx" in data and "cy" in data):
        raise ValueError("neither cx and cy nor w and h")
    middle = (size[0] / 2, size[1] / 2) if size else (0, 0)
    cx, cy = (float(data.get(key, middle[axis])) - 0.5 for axis, key in enumerate(("cx", "cy")))
    K = matrix(float(fx), float(fx if fy is None else fy), cx, cy)
    return Camera(K, size, _lens(data))


def _lens(data: Mapping[str, Any]) -> Distortion | None:
    model = str(data.get("camera_model", "OPENCV"))
    k1, k2, k3, k4 = (float(data.get(key, 0)) for key in _RADIAL)
    p1, p2 = (float(data.get(key, 0)) for key in _TANGENTIAL)
    if model == "OPENCV_FISHEYE" or data.get("is_fisheye"):
        return fisheye_lens((k1, k2, k3, k4))
    if model not in _PERSPECTIVE:
        raise InputError(f"the camera_model {model!r} is not read")
    if k4:  # of the eighth power of the radius
        raise InputError(f"k4 of the camera_model {model}, which no COLMAP model has")
    return opencv_lens((k1, k2, p1, p2, k3))
