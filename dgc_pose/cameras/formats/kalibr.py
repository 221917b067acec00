"""Kalibr's camchain.yaml: the cameras cam0, cam1, ... of a rig; and EuRoC's sensor.yaml of one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import (
    FileCameras,
    fisheye_lens,
    matrix,
    opencv_lens,
    rig,
)
from dgc_pose.errors import InputError


def is_camchain(data: Mapping[str, Any]) -> bool:
    """Whether this is a camchain, or one camera of it."""
    return bool(_cameras(data))


def camchain(data: Mapping[str, Any], path: Path) -> FileCameras:
    """The cameras of a camchain: "cam0" is that of images that lie below no folder of such a name.

    path: for the identity of the cameras. Raises InputError for a model that COLMAP does not have.
    """
    cameras = _cameras(data)
    return rig({name: _camera(values, name) for name, values in cameras.items()}, path)


def _cameras(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    if "intrinsics" in data:
        return {"cam0": data}
    return {
        str(name): values
        for name, values in data.items()
        if isinstance(values, Mapping) and "intrinsics" in values
    }


def _camera(data: Mapping[str, Any], where: str) -> Camera:
    model, numbers = data.get("camera_model", "pinhole"), [float(x) for x in data["intrinsics"]]
    lens = _lens(data, where)
    if model == "eucm" and len(numbers) == 6 and lens is None:
        lens, numbers = Distortion("EUCM", tuple(numbers[:2])), numbers[2:]
    elif model != "pinhole":
        raise InputError(f"{where}: the camera_model {model!r} has no COLMAP model")
    size = data.get("resolution")
    return Camera(matrix(*numbers), None if size is None else (int(size[0]), int(size[1])), lens)


def _lens(data: Mapping[str, Any], where: str) -> Distortion | None:
    model = str(data.get("distortion_model", "none"))
    listed = data.get("distortion_coeffs") or data.get("distortion_coefficients") or ()
    coefficients = [float(value) for value in listed]
    if model == "none":
        return None
    if model in ("radtan", "radial-tangential", "plumb_bob"):
        return opencv_lens(coefficients)
    if model == "equidistant":
        return fisheye_lens(coefficients)
    if model == "fov":
        return Distortion("FOV", tuple(coefficients))
    raise InputError(f"{where}: the distortion_model {model!r} has no COLMAP model")
