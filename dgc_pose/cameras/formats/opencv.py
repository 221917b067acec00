"""A camera by its keys: OpenCV's cv::FileStorage, YAML, XML or JSON, and JSON of our own.

Names of the camera matrix and the size are those of OpenCV's own programs. The fisheye model is
told by `fisheye_model: 1`, as OpenCV's sample writes. Four coefficients alone do not say it: as the
part "fisheye" they are of that model.

cv::FileStorage does not read them here: damaged files of a few hundred bytes end the process.
"""

from collections.abc import Mapping
from contextlib import suppress
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
)
from dgc_pose.cameras.formats.lens import file_lens, require_read
from dgc_pose.errors import InputError

_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k")
_SIZES = (
    *(("size",), ("image_size",), ("imageSize",), ("cameraResolution",)),
    *(("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height")),
)
_PARTS = {"K1": "K1", "K2": "K2", "camera1": "K1", "camera2": "K2"}  # of a pair
_MAX_FOCAL_STD = 1.0  # relative


def xml_data(node: ElementTree.Element) -> Any:
    """The values of an XML of cv::FileStorage, as its YAML and JSON have them."""
    return {child.tag: xml_data(child) for child in node} if len(node) else node.text


def is_keyed(data: Mapping[str, Any]) -> bool:
    """Whether a camera matrix, a focal length or a pair of cameras is among the keys."""
    return not {*_MATRICES, "fx", *_PARTS}.isdisjoint(data)


def keyed_cameras(data: Mapping[str, Any]) -> FileCameras:
    """The `keyed_camera`, and the same as a fisheye where that may be; of {"K1", "K2"} or the
    output's {"camera1", "camera2"} two cameras, which are matrices or such mappings.

    Raises as `keyed_camera` does.
    """
    read = [key for key in _PARTS if data.get(key)]
    if read:
        require_read(data, *read)
        return FileCameras(parts={_PARTS[key]: keyed_camera(data[key]) for key in read})
    camera = keyed_camera(data)
    parts = {}
    with suppress(InputError):  # of other coefficients than four
        parts["fisheye"] = keyed_camera({**data, "fisheye_model": 1})
    return FileCameras(parts=parts, common=camera)


def keyed_camera(data: Any) -> Camera:
    """The camera of a matrix, or of a mapping with a matrix or fx, fy, cx, cy, a size, and a lens:
    COLMAP's as "model" and "coefficients", or as `file_lens` reads it.

    Raises InputError, KeyError, TypeError or ValueError for what is none.
    """
    if not isinstance(data, Mapping):
        return numbers_camera(data)
    key = next((key for key in _MATRICES if data.get(key) not in (None, "")), None)
    if key is not None:
        K = numbers_camera(numbers(data[key]) or (), key).K
    else:
        K = matrix(*(float(data[key]) for key in ("fx", "fy", "cx", "cy")))
    lens: Distortion | None
    if data.get("model"):
        require_read(data, key, "model", "coefficients")
        lens = Distortion(str(data["model"]), tuple(numbers(data.get("coefficients")) or ()))
    else:
        lens = file_lens(data, key)
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
            held = [number for key in keys for number in numbers(data[key]) or ()]
            if len(held) != 2:
                raise InputError(f"{' and '.join(keys)}: no width and height")
            return int(held[0]), int(held[1])
    return None
