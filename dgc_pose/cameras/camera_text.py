"""One camera from a text or from a file of numbers."""

import io
import re
from pathlib import Path

import numpy as np

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.errors import InputError, shortened
from dgc_pose.files.arrays import read_array
from dgc_pose.files.inputs import read_as, read_text

_MAX_FILE_BYTES = 4096  # of a file with nine numbers


def parse_numbers(text: str, name: str) -> Camera:
    """The camera of `fx,fy,cx,cy` or of COLMAP's `MODEL,width,height,parameters...`.

    Raises InputError of one line, naming `name`.
    """
    words = re.split(r"\s*,\s*", text.strip())
    numbers = _floats(words)
    if numbers is None and len(words) > 3 and re.fullmatch(r"[A-Za-z][A-Za-z_]*", words[0]):
        return _parse_colmap(words, name)
    if numbers is None or len(numbers) != 4:
        raise InputError(
            f"{name}: {shortened(text)!r} is neither fx,fy,cx,cy nor MODEL,width,height,parameters "
            f"nor a file"
        )
    fx, fy, cx, cy = numbers
    return matrix_camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], name)


def read_matrix(path: Path, name: str) -> Camera:
    """The camera of a text or .npy file with a 3x3 matrix; commas and line breaks are as blanks.

    Raises InputError of one line, naming `name`.
    """
    try:
        with read_as("a 3x3 matrix", path):
            if path.suffix.lower() == ".npy":
                matrix = read_array(path)
            else:
                text = read_text(path, "a 3x3 matrix", _MAX_FILE_BYTES).replace(",", " ")
                matrix = np.loadtxt(io.StringIO(text), ndmin=2)
            if not matrix.size:
                raise InputError(f"{path} is empty")
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except OSError as error:
        raise InputError(f"{name}: {path}: {error.strerror or error}") from error
    return matrix_camera(matrix.reshape(3, 3) if matrix.size == 9 else matrix, f"{name}: {path}")


def _parse_colmap(words: list[str], name: str) -> Camera:
    size, parameters = _floats(words[1:3]), _floats(words[3:])
    if size is None or parameters is None or any(not side.is_integer() for side in size):
        text = shortened(",".join(words))
        raise InputError(f"{name}: expected MODEL,width,height,parameters, not {text!r}")
    try:
        K, distortion = colmap_camera.intrinsics(words[0].upper(), parameters)
        return Camera(K, (int(size[0]), int(size[1])), distortion)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _floats(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None
