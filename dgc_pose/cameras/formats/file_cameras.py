"""What a file says of cameras, and the lenses that several formats share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError

Size = tuple[int, int]  # (width, height), pixels


@dataclass(frozen=True)
class FileCameras:
    """The cameras of a file."""

    by_name: Mapping[str, Camera] = field(default_factory=dict)  # of images, names as written
    # Of a rig or a pair: "cam1" of Kalibr, "image_2" of KITTI, "K2" of the second image.
    parts: Mapping[str, Camera] = field(default_factory=dict)
    common: Camera | None = None  # of all other images


def matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """K (3, 3) of four numbers."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def rig(parts: Mapping[str, Camera], path: Path) -> FileCameras:
    """The cameras of a rig, each of the images below a folder of its name; the first is that of
    other images."""
    parts = {name: replace(camera, identity=f"{path} {name}") for name, camera in parts.items()}
    return FileCameras(parts=parts, common=next(iter(parts.values())))


def opencv_lens(coefficients: Sequence[float]) -> Distortion | None:
    """COLMAP's model of OpenCV's coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]].

    None if all are zero. Raises InputError for another number of them, and for a thin prism or a
    tilted sensor, which COLMAP has for no lens of this kind.
    """
    if len(coefficients) not in (0, 4, 5, 8, 12, 14):
        raise InputError(f"{len(coefficients)} distortion coefficients, not 4, 5, 8, 12 or 14")
    values = (*coefficients, *[0.0] * (14 - len(coefficients)))
    if any(values[8:]):
        raise InputError(
            "the distortion has a thin prism or a tilted sensor, which no COLMAP model has: "
            "calibrate without CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL"
        )
    if any(values[4:]):
        return Distortion("FULL_OPENCV", values[:8])
    return Distortion("OPENCV", values[:4]) if any(values) else None


def fisheye_lens(coefficients: Sequence[float]) -> Distortion:
    """COLMAP's model of OpenCV's fisheye coefficients k1 k2 k3 k4, which are the equidistant ones
    of Kalibr and ROS. Raises InputError for another number of them."""
    if len(coefficients) != 4:
        raise InputError(f"{len(coefficients)} fisheye coefficients, not 4")
    return Distortion("OPENCV_FISHEYE", tuple(coefficients))
