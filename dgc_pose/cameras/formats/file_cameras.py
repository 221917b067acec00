"""The cameras of a file, and the numbers in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.errors import InputError

Size = tuple[int, int]  # (width, height), pixels


@dataclass(frozen=True)
class FileCameras:
    """The cameras of a file."""

    by_name: Mapping[str, Camera] = field(default_factory=dict)  # of images, names as written
    # Of a rig or a pair: "cam1" of Kalibr, "image_2" of KITTI, "K2" of the second image.
    parts: Mapping[str, Camera] = field(default_factory=dict)
    common: Camera | None = None  # of all other images
    refused: Mapping[str, str] = field(default_factory=dict)  # further parts: why they have none


def matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """K (3, 3) of four numbers."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def numbers(value: Any) -> list[float] | None:
    """The numbers of a text, a list, or a matrix of cv::FileStorage or ROS, row by row; None if it
    holds anything else."""
    if isinstance(value, Mapping):
        value = value.get("data", "none")
    if isinstance(value, str):
        value = value.replace(",", " ").split()
    try:
        return [] if value is None else np.array(value, np.float64).ravel().tolist()
    except (TypeError, ValueError, OverflowError):
        return None


def numbers_camera(values: Any, name: str = "K") -> Camera:
    """The camera of fx fy cx cy, or of the nine numbers of a matrix.

    Raises InputError, naming `name`.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.size == 4:
        return matrix_camera(matrix(*array.ravel().tolist()), name)
    if array.size != 9:
        raise InputError(f"{name} has {array.size} numbers, not fx fy cx cy and no 3x3 matrix")
    if not array.any():
        raise InputError(f"{name} is all zeros: the camera is not calibrated")
    return matrix_camera(array.reshape(3, 3), name)


def rig(parts: Mapping[str, Camera], path: Path, refused: Mapping[str, str]) -> FileCameras:
    """The cameras of a rig, each of the images below a folder of its name; the first is that of
    other images. refused: of the rig's further cameras, why they are not read."""
    parts = {name: replace(camera, identity=f"{path} {name}") for name, camera in parts.items()}
    return FileCameras(parts=parts, common=next(iter(parts.values()), None), refused=refused)
