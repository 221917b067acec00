"""ROS's camera_info: the YAML of its calibrators, and the message as `rostopic echo` prints it.

The camera is that of the raw image: camera_matrix (K) with its distortion, not the projection of
the rectified one.
"""

from collections.abc import Mapping
from typing import Any

from dgc_pose.cameras.formats.file_cameras import FileCameras
from dgc_pose.cameras.formats.opencv import keyed_camera
from dgc_pose.errors import InputError


def is_camera_info(data: Mapping[str, Any]) -> bool:
    """Whether this is a camera_info."""
    return "distortion_model" in data and not {"camera_matrix", "K", "k"}.isdisjoint(data)


def camera_info(data: Mapping[str, Any]) -> FileCameras:
    """The camera of a camera_info.

    Raises InputError for a lens that COLMAP has no model of, and for a message of
    another image than the whole sensor's.
    """
    _require_whole(data)
    return FileCameras(common=keyed_camera(data))


def _require_whole(data: Mapping[str, Any]) -> None:
    """Raise InputError if the message's image is a part of the sensor's, or of fewer pixels."""
    roi = data.get("roi") or {}
    if any(int(data.get(key) or 0) > 1 for key in ("binning_x", "binning_y")) or any(
        int(roi.get(key) or 0) for key in ("x_offset", "y_offset")
    ):
        raise InputError("binning or roi is set, and K is of the whole sensor's image")
