"""OpenCV's cv::FileStorage: YAML, XML or JSON with a camera matrix and distortion coefficients.

Names of the camera matrix, the coefficients and the size are those of OpenCV's own programs. The
fisheye model is told by `fisheye_model: 1`, as OpenCV's sample writes. Four coefficients alone do
not say it: as the part "fisheye" they are of that model.

cv::FileStorage does not read them here: damaged files of a few hundred bytes end the process.
"""

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.cameras.formats.file_cameras import FileCameras, Size, fisheye_lens, opencv_lens
from dgc_pose.errors import InputError

_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_COEFFICIENTS = (
    "distortion_coefficients",
    "dist_coeffs",
    "distCoeffs",
    "distortionCoefficients",
    "Distortion_Coefficients",
    "D",
)
_SIZES = ("image_size", "imageSize", "cameraResolution")
_WIDTHS = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_FISHEYE_COUNT = 4


def xml_data(text: str) -> dict[str, Any]:
    """The values of an XML of cv::FileStorage, as its YAML and JSON have them."""
    data: dict[str, Any] = {}
    for node in ElementTree.fromstring(text):
        numbers = node.find("data")
        data[node.tag] = node.text if numbers is None else {"data": (numbers.text or "").split()}
    return data


def is_storage(data: Mapping[str, Any]) -> bool:
    """Whether this is of cv::FileStorage: a camera matrix by its names, or K with coefficients."""
    has_coefficients = not {*_COEFFICIENTS}.isdisjoint(data)
    return any(
        name in data and (name != "K" or has_coefficients or isinstance(data[name], Mapping))
        for name in _MATRICES
    )


def storage_camera(data: Mapping[str, Any]) -> FileCameras:
    """The camera of a file of cv::FileStorage, and the same as a fisheye.

    Raises InputError for a lens that COLMAP has no model of.
    """
    if "xi" in data:
        raise InputError("an omnidirectional camera (xi), which no COLMAP model is")
    K = _numbers(data, _MATRICES)
    coefficients = _numbers(data, _COEFFICIENTS).tolist()
    is_fisheye = str(data.get("fisheye_model", 0)).strip() == "1"
    lens = fisheye_lens(coefficients) if is_fisheye else opencv_lens(coefficients)
    if K.size != 9:
        raise InputError(f"the camera matrix has {K.size} numbers, not 9")
    camera = Camera(matrix_camera(K.reshape(3, 3)).K, _size(data), lens)
    if len(coefficients) != _FISHEYE_COUNT:
        return FileCameras(common=camera)
    fisheye = Camera(camera.K, camera.size, fisheye_lens(coefficients))
    return FileCameras(parts={"fisheye": fisheye}, common=camera)


def _numbers(data: Mapping[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """The numbers of the first of these names, row by row."""
    value = next((data[name] for name in names if name in data), ())
    return np.array(value["data"] if isinstance(value, Mapping) else value, np.float64).ravel()


def _size(data: Mapping[str, Any]) -> Size | None:
    for name in _SIZES:
        if name in data:
            value = data[name]
            width, height = value.split() if isinstance(value, str) else value
            return int(float(width)), int(float(height))
    for names in _WIDTHS:
        if all(name in data for name in names):
            return int(float(data[names[0]])), int(float(data[names[1]]))
    return None
