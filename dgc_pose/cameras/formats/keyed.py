"""Cameras by their keys: OpenCV's cv::FileStorage, ROS's camera_info, Kalibr's camchain.yaml,
EuRoC's sensor.yaml, and JSON as `camera_data` writes it.

cv::FileStorage does not read them here: damaged files of a few hundred bytes end the process.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import (
    FileCameras,
    Size,
    matrix,
    numbers,
    numbers_camera,
    rig,
)
from dgc_pose.cameras.formats.lens import file_lens, require_read
from dgc_pose.errors import InputError

# Names of the matrix and the size as OpenCV's programs and ROS write them. The `camera_matrix` of
# ROS is that of the raw image, which its distortion belongs to.
_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k")
_SIZES = (
    *(("size",), ("image_size",), ("imageSize",), ("cameraResolution",)),
    *(("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height")),
)
_CAMERAS_OF_A_PAIR = {"K1": "K1", "K2": "K2", "camera1": "K1", "camera2": "K2"}
_MAX_FOCAL_STD = 1.0  # relative


def xml_data(node: ElementTree.Element) -> Any:
    """The values of an XML of cv::FileStorage, as its YAML and JSON have them."""
    return {child.tag: xml_data(child) for child in node} if len(node) else node.text


def is_keyed(data: Mapping[str, Any]) -> bool:
    """Whether a camera matrix, a focal length or a pair of cameras is among the keys."""
    return not {*_MATRICES, "fx", *_CAMERAS_OF_A_PAIR}.isdisjoint(data)


def is_camera_info(data: Mapping[str, Any]) -> bool:
    """Whether this is a camera_info: the YAML of ROS's calibrators, or the message as printed."""
    return "distortion_model" in data and not {"camera_matrix", "K", "k"}.isdisjoint(data)


def keyed_cameras(data: Mapping[str, Any]) -> FileCameras:
    """The `keyed_camera`, and as the part "fisheye" the same with OpenCV's fisheye model, which
    four coefficients alone do not name; of {"K1", "K2"} or the output's {"camera1", "camera2"} two
    cameras, which are matrices or such mappings.

    Raises as `keyed_camera` does.
    """
    present = [key for key in _CAMERAS_OF_A_PAIR if data.get(key)]
    if present:
        require_read(data, *present)
        parts = {_CAMERAS_OF_A_PAIR[key]: keyed_camera(data[key]) for key in present}
        return FileCameras(parts=parts)
    camera = keyed_camera(data)
    parts = {}
    if not is_camera_info(data):
        with suppress(InputError):  # of other coefficients than four
            parts["fisheye"] = keyed_camera({**data, "fisheye_model": 1})
    return FileCameras(parts=parts, common=camera)


def keyed_camera(data: Any, key: str | None = None) -> Camera:
    """The camera of a matrix, or of a mapping with a matrix or fx, fy, cx, cy, a size, and a lens:
    COLMAP's as "model" and "coefficients", or as `file_lens` reads it.

    key: of the matrix or the four numbers, by default one of OpenCV's names. Raises InputError,
    KeyError, TypeError or ValueError for what is none, and for a message of ROS whose image is not
    the whole sensor's.
    """
    if not isinstance(data, Mapping):
        return numbers_camera(data)
    key = key or next((key for key in _MATRICES if data.get(key) not in (None, "")), None)
    if is_camera_info(data):
        _require_whole(data)
    lens: Distortion | None
    if data.get("model"):
        require_read(data, key, "model", "coefficients")
        lens = Distortion(str(data["model"]), tuple(numbers(data.get("coefficients")) or ()))
    else:
        lens = file_lens(data, key)
    if key is not None:
        K = numbers_camera(numbers(data[key]) or (), key).K
    else:
        K = matrix(*(float(data[key]) for key in ("fx", "fy", "cx", "cy")))
    focal_std = float(data.get("focal_std") or 0)
    if focal_std > _MAX_FOCAL_STD:
        raise InputError(f"focal_std is {focal_std:g}, more than {_MAX_FOCAL_STD:g}: no K at all")
    identity = data.get("identity")
    return Camera(
        K,
        _size(data),
        lens,
        focal_std=focal_std,
        centre_std=float(data.get("centre_std_px") or 0),
        identity=None if identity is None else str(identity),
    )


def _size(data: Mapping[str, Any]) -> Size | None:
    for keys in _SIZES:
        if all(map(data.get, keys)):
            sides = [number for key in keys for number in numbers(data[key]) or ()]
            if len(sides) != 2:
                raise InputError(f"{' and '.join(keys)}: no width and height")
            return int(sides[0]), int(sides[1])
    return None


def _require_whole(data: Mapping[str, Any]) -> None:
    """Raise InputError if the message's image is a part of the sensor's, or of fewer pixels."""
    roi = data.get("roi") or {}
    if any(int(data.get(key) or 0) > 1 for key in ("binning_x", "binning_y")) or any(
        int(roi.get(key) or 0) for key in ("x_offset", "y_offset")
    ):
        raise InputError("binning or roi is set, and K is of the whole sensor's image")


def camchain_cameras(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The cameras of a Kalibr file by their names, of one alone as "cam0"; none in other files."""
    if "intrinsics" in data:
        return {"cam0": data}
    return {
        str(name): values
        for name, values in data.items()
        if isinstance(values, Mapping) and "intrinsics" in values
    }


def camchain(data: Mapping[str, Any], path: Path) -> FileCameras:
    """The cameras of a camchain: "cam0" is that of images that lie below no folder of such a name.

    path: for the identity of the cameras. A camera of a model that COLMAP does not have is refused.
    Raises InputError as `require_read` does.
    """
    listed = camchain_cameras(data)
    cameras: dict[str, Camera] = {}
    refused: dict[str, str] = {}
    for name, values in listed.items():
        try:
            cameras[name] = _rig_camera(values)
        except InputError as error:
            refused[name] = f"{name}: {error}"
    if data is not listed.get("cam0"):
        require_read(data, *listed)
    return rig(cameras, path, refused)


def _rig_camera(data: Mapping[str, Any]) -> Camera:
    values = {"distortion_model": "none", **data, "size": data.get("resolution")}
    held = numbers(data["intrinsics"]) or []
    if data.get("camera_model") == "eucm" and len(held) == 6:
        del values["camera_model"], values["distortion_model"]
        values |= {"model": "EUCM", "coefficients": held[:2], "intrinsics": held[2:]}
    return keyed_camera(values, "intrinsics")
