"""Kalibr's camchain.yaml: the cameras cam0, cam1, ... of a rig; and EuRoC's sensor.yaml of one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import FileCameras, matrix, rig
from dgc_pose.cameras.formats.lens import file_lens, require_read
from dgc_pose.errors import InputError


def is_camchain(data: Mapping[str, Any]) -> bool:
    """Whether this is a camchain, or one camera of it."""
    return bool(_cameras(data))


def camchain(data: Mapping[str, Any], path: Path) -> FileCameras:
    """The cameras of a camchain: "cam0" is that of images that lie below no folder of such a name.

    path: for the identity of the cameras. A camera of a model that COLMAP does not have is refused.
    Raises InputError as `require_read` does.
    """
    listed = _cameras(data)
    cameras: dict[str, Camera] = {}
    refused: dict[str, str] = {}
    for name, values in listed.items():
        try:
            cameras[name] = _camera(values)
        except InputError as error:
            refused[name] = f"{name}: {error}"
    if data is not listed.get("cam0"):
        require_read(data, *listed)
    return rig(cameras, path, refused)


def _cameras(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    if "intrinsics" in data:
        return {"cam0": data}
    return {
        str(name): values
        for name, values in data.items()
        if isinstance(values, Mapping) and "intrinsics" in values
    }


def _camera(data: Mapping[str, Any]) -> Camera:
    numbers = [float(x) for x in data["intrinsics"]]
    is_eucm = data.get("camera_model") == "eucm" and len(numbers) == 6
    alone = {"camera_model": "pinhole", "distortion_model": "none"} if is_eucm else {}
    lens = file_lens({"distortion_model": "none", **data, **alone}, "intrinsics")
    if is_eucm:
        lens, numbers = Distortion("EUCM", tuple(numbers[:2])), numbers[2:]
    size = data.get("resolution")
    return Camera(matrix(*numbers), None if size is None else (int(size[0]), int(size[1])), lens)
