"""Numbers: fx fy cx cy or a 3x3 matrix as text or .npy, a table of cameras, and JSON of our own.

Pixels have (0, 0) at the centre of the top-left pixel.
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import FileCameras, Size, matrix
from dgc_pose.errors import InputError, reason
from dgc_pose.files.arrays import read_array
from dgc_pose.files.inputs import read_as

_PARTS = {"K1": "K1", "K2": "K2", "camera1": "K1", "camera2": "K2"}  # of a pair
_MAX_FOCAL_STD = 1.0  # relative


def numbers_of(text: str) -> list[float] | None:
    """The numbers of a text, split by commas and blanks; None if it has anything else."""
    try:
        return [float(word) for word in re.split(r"[\s,]+", text.strip().strip(","))]
    except ValueError:
        return None


def numbers_camera(numbers: Any, name: str = "K") -> Camera:
    """The camera of fx fy cx cy, or of the nine numbers of a matrix.

    Raises InputError, naming `name`.
    """
    array = np.asarray(numbers, dtype=np.float64)
    if array.size == 4:
        return matrix_camera(matrix(*array.ravel().tolist()), name)
    if array.size != 9:
        raise InputError(f"{name} has {array.size} numbers, not fx fy cx cy and no 3x3 matrix")
    return matrix_camera(array.reshape(3, 3), name)


def read_npy(path: Path) -> FileCameras:
    """The camera of an .npy. Raises InputError."""
    return FileCameras(common=numbers_camera(read_array(path)))


def read_table(text: str, path: Path) -> FileCameras:
    """The cameras of a .csv with the columns name, fx, fy, cx, cy, and optionally width, height,
    focal_std, and camera, equal for images of one camera.

    Raises InputError, with the path and line.
    """
    with read_as("a table of cameras", path):
        rows = list(csv.DictReader(text.splitlines()))
    cameras = {}
    for number, row in enumerate(rows, start=2):
        try:
            size = (int(row["width"]), int(row["height"])) if row.get("width") else None
            K = matrix(*(float(row[key]) for key in ("fx", "fy", "cx", "cy")))
            cameras[row["name"]] = Camera(
                K,
                size,
                focal_std=float(row.get("focal_std") or 0),
                centre_std=float(row.get("centre_std_px") or 0),
                identity=row.get("camera") or None,
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{path}:{number}: expected the columns name,fx,fy,cx,cy[,width,height] "
                f"({reason(error)})"
            ) from None
    if not cameras:
        raise InputError(f"{path}: no cameras in this table")
    return FileCameras(cameras)


def is_cameras_json(data: Mapping[str, Any]) -> bool:
    """Whether this is JSON of `json_cameras`."""
    return not {"K", "fx", *_PARTS}.isdisjoint(data)


def json_cameras(data: Mapping[str, Any]) -> FileCameras:
    """The camera of {"K": 3x3} or {"fx", "fy", "cx", "cy"}, with "size" or "width" and "height",
    and "model" and "coefficients" of a lens, if they are there; of {"K1", "K2"} or the output's
    {"camera1", "camera2"} two cameras, which are matrices or such entries.

    Raises InputError.
    """
    try:
        parts = {part: _json_camera(data[key]) for key, part in _PARTS.items() if data.get(key)}
        if not parts:
            return FileCameras(common=_json_camera(data))
        return FileCameras(parts=parts)
    except (KeyError, TypeError, IndexError, OverflowError) as error:
        raise InputError(f"not a camera in JSON ({reason(error)})") from None


def _json_camera(data: Any) -> Camera:
    if not isinstance(data, Mapping):
        return numbers_camera(data)
    if "K" in data:
        K = numbers_camera(data["K"]).K
    else:
        K = matrix(*(float(data[key]) for key in ("fx", "fy", "cx", "cy")))
    size: Size | None = None
    if data.get("size") is not None:
        size = int(data["size"][0]), int(data["size"][1])
    elif "width" in data and "height" in data:
        size = int(data["width"]), int(data["height"])
    lens = None
    if data.get("model") is not None:
        lens = Distortion(str(data["model"]), tuple(float(x) for x in data["coefficients"]))
    focal_std = float(data.get("focal_std") or 0)
    if focal_std > _MAX_FOCAL_STD:
        raise InputError(f"focal_std is {focal_std:g}, more than {_MAX_FOCAL_STD:g}: no K at all")
    identity = data.get("identity")
    return Camera(
        K,
        size,
        lens,
        focal_std=focal_std,
        centre_std=float(data.get("centre_std_px") or 0),
        identity=None if identity is None else str(identity),
    )
