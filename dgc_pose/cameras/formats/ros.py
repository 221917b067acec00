"""ROS's camera_info: the YAML of its calibrators, and the message as `rostopic echo` prints it.

The camera is that of the raw image: camera_matrix (K) with its distortion, not the projection of
the rectified one.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import FileCameras, fisheye_lens, opencv_lens
from dgc_pose.errors import InputError

_OPENCV = ("plumb_bob", "rational_polynomial", "")


def is_camera_info(data: Mapping[str, Any]) -> bool:
    """Whether this is a camera_info."""
    return "distortion_model" in data and not {"camera_matrix", "K", "k"}.isdisjoint(data)


def camera_info(data: Mapping[str, Any]) -> FileCameras:
    """The camera of a camera_info.

    Raises InputError for a lens that COLMAP has no model of, and for a message of
    another image than the whole sensor's.
    """
    if "camera_matrix" in data:
        K = data["camera_matrix"]["data"]
        coefficients = data.get("distortion_coefficients", {}).get("data") or ()
        size = int(data["image_width"]), int(data["image_height"])
    else:
        K = data["K"] if "K" in data else data["k"]
        coefficients = data.get("D") or data.get("d") or ()
        size = int(data["width"]), int(data["height"])
    _require_whole(data)
    lens = _lens(str(data["distortion_model"]), [float(value) for value in coefficients])
    return FileCameras(common=Camera(np.array(K, dtype=np.float64).reshape(3, 3), size, lens))


def _lens(model: str, coefficients: list[float]) -> Distortion | None:
    if model in _OPENCV:
        return opencv_lens(coefficients)
    if model in ("equidistant", "fisheye"):
        return fisheye_lens(coefficients)
    raise InputError(f"the distortion_model {model!r} has no COLMAP model")


def _require_whole(data: Mapping[str, Any]) -> None:
    """Raise InputError if the message's image is a part of the sensor's, or of fewer pixels."""
    roi = data.get("roi") or {}
    if any(int(data.get(key) or 0) > 1 for key in ("binning_x", "binning_y")) or any(
        int(roi.get(key) or 0) for key in ("x_offset", "y_offset")
    ):
        raise InputError("binning or roi is set, and K is of the whole sensor's image")
