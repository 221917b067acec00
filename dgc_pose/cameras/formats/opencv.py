"""OpenCV's cv::FileStorage: YAML, XML or JSON with a camera matrix and distortion coefficients.

Names of the camera matrix, the coefficients and the size are those of OpenCV's own programs. The
fisheye model is told by `fisheye_model: 1`, as OpenCV's sample writes. Four coefficients alone do
not say it: as the part "fisheye" they are of that model.
"""

from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.file_cameras import FileCameras, Size, fisheye_lens, opencv_lens
from dgc_pose.errors import InputError, reason

_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_COEFFICIENTS = (
    "distortion_coefficients",
    "dist_coeffs",
    "distCoeffs",
    "distortionCoefficients",
    "Distortion_Coefficients",
    "D",
)
_FISHEYE_COUNT = 4
_MAX_TEXT = 2**20  # characters: a calibration with its views has some thousand
_SIZES = ("image_size", "imageSize", "cameraResolution")
_WIDTHS = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))


def is_storage(text: str) -> bool:
    """Whether a text is of cv::FileStorage with matrices."""
    return "<opencv_storage>" in text or "opencv-matrix" in text


def read_storage(text: str) -> FileCameras:
    """The camera of a text of cv::FileStorage, and the same as a fisheye.

    Raises InputError if it has none, and for a lens that COLMAP has no model of.
    """
    if len(text) > _MAX_TEXT:
        raise InputError(f"{len(text)} characters of cv::FileStorage, at most {_MAX_TEXT} are read")
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        K, values = _matrix(storage, _MATRICES), _matrix(storage, _COEFFICIENTS)
        size = _size(storage)
        is_fisheye = _number(storage.getNode("fisheye_model")) == 1
        has_xi = not storage.getNode("xi").empty()
    except (cv2.error, SystemError, ValueError) as error:
        raise InputError(f"not a file of cv::FileStorage ({reason(error)})") from None
    if K is None:
        raise InputError(f"no {_MATRICES[0]} in this file of cv::FileStorage")
    if has_xi:
        raise InputError("an omnidirectional camera (xi), which no COLMAP model is")
    coefficients = [] if values is None else values.ravel().tolist()
    lens = fisheye_lens(coefficients) if is_fisheye else opencv_lens(coefficients)
    parts = {}
    if len(coefficients) == _FISHEYE_COUNT:
        parts["fisheye"] = Camera(K, size, fisheye_lens(coefficients))
    return FileCameras(parts=parts, common=Camera(K, size, lens))


def _matrix(storage: cv2.FileStorage, names: tuple[str, ...]) -> np.ndarray | None:
    """The first matrix or list of these names."""
    for name in names:
        node = storage.getNode(name)
        if node.isSeq():
            return np.array([node.at(i).real() for i in range(node.size())])
        if not node.empty():
            matrix = node.mat()
            if matrix is None:
                raise ValueError(f"{name} is no matrix")
            return np.asarray(matrix, dtype=np.float64)
    return None


def _size(storage: cv2.FileStorage) -> Size | None:
    for name in _SIZES:
        node: Any = storage.getNode(name)
        if node.isSeq() and node.size() == 2:
            return int(node.at(0).real()), int(node.at(1).real())
    for names in _WIDTHS:
        width, height = (_number(storage.getNode(name)) for name in names)
        if width and height:
            return int(width), int(height)
    return None


def _number(node: Any) -> float | None:
    return float(node.real()) if node.isInt() or node.isReal() else None
