"""A camera: its intrinsic matrix K, the image size that K refers to, and its lens distortion.

Pixels have (0, 0) at the centre of the top-left pixel; COLMAP has (0.5, 0.5) there.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError, shortened
from dgc_pose.files.arrays import as_numpy, read_array
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.geometry.pixels import rescale

FocalSource = Literal["given", "exif", "size", "matches"]
_USUAL_OFFSET = 0.2  # of the principal point from the middle, as a share of the image's side
_MAX_FILE_BYTES = 4096  # of a file with nine numbers


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera. Raises InputError if K is not an intrinsic matrix, see `as_camera`."""

    K: np.ndarray  # (3, 3) float64, pixels
    size: tuple[int, int] | None = None  # (width, height) of the image K refers to; None if unknown
    distortion: Distortion | None = None  # of the lens; None for a pinhole
    warnings: tuple[str, ...] = ()  # about the origin of K, for the user
    # Standard deviation of the logarithm of the focal lengths; 0: they are exact. The estimation
    # fits the focal lengths of a camera with a deviation, with K as the prior.
    focal_std: float = 0.0
    centre_std: float = 0.0  # of each coordinate of the principal point, pixels
    focal_source: FocalSource = "given"  # what says the focal length: "size" is the image's
    # Images whose cameras have the same identity were taken by one camera: K is wrong by the same
    # factor. None: a camera of its image alone.
    identity: str | None = None
    guessed_focal: bool = False  # whether the focal length is from EXIF data or the image's size

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", _checked_matrix(self.K, "K"))
        if self.size is not None and not (self.size[0] > 0 and self.size[1] > 0):
            raise InputError(f"size must be positive, not {self.size[0]} x {self.size[1]}")

    @property
    def focal(self) -> float:
        """Mean of the focal lengths along x and y, pixels."""
        return float(self.K[0, 0] + self.K[1, 1]) / 2

    def normalise(self, points: np.ndarray) -> np.ndarray:
        """Pixels u (N, 2) to normalised coordinates K^-1 u (N, 2) float64, without distortion.

        NaN for points whose distortion cannot be undone. Raises InputError for another shape.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"points must have shape (N, 2), not {points.shape}")
        y = (points[:, 1] - self.K[1, 2]) / self.K[1, 1]
        x = (points[:, 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        normalised = np.column_stack([x, y])
        return normalised if self.distortion is None else self.distortion.undo(normalised)

    def project(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `normalise`: normalised points (N, 2), x / z and y / z, to pixels."""
        points = np.asarray(points, dtype=np.float64)
        distorted = points if self.distortion is None else self.distortion.apply(points)
        return distorted @ self.K[:2, :2].T + self.K[:2, 2]

    def resized(self, size: tuple[int, int]) -> Camera:
        """The camera of the image resized to (width, height), each side by its own factor.

        Raises InputError if the camera has no size.
        """
        if self.size is None:
            raise InputError("a camera without a size cannot be resized")
        scale = np.array([size[0] / self.size[0], size[1] / self.size[1], 1.0])
        K = self.K * scale[:, None]
        K[:2, 2] = rescale(self.K[:2, 2], self.size, size)
        return replace(self, K=K, size=(int(size[0]), int(size[1])))


def as_camera(value: Camera | Any, name: str = "K") -> Camera:
    """A camera from a Camera, an array (3, 3), a path, or a text (see `parse_camera`).

    Raises InputError, naming the argument `name`, unless the matrix is finite, invertible and upper
    triangular with positive focal lengths and a last row of 0 0 1.
    """
    if isinstance(value, Camera):
        return value
    if isinstance(value, (str, Path)):
        return parse_camera(str(value), name)
    return Camera(_checked_matrix(value, name))


def parse_camera(text: str, name: str = "K", *, files: bool = True) -> Camera:
    """A camera from a text, as on the command line.

    The text is 'fx,fy,cx,cy' in pixels, (0, 0) the centre of the top-left pixel; or the path of a
    text or .npy file with a 3x3 matrix; or a COLMAP camera 'MODEL,width,height,parameters...' with
    COLMAP's principal point, half a pixel more than ours. files: whether the text may be a path;
    False for a stranger's text. Raises InputError of one line, naming `name`.
    """
    if files and os.path.lexists(text):
        return as_camera(_read_matrix(Path(text), name), f"{name}: {text}")
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
    return as_camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], name)


def check_size(camera: Camera, size: tuple[int, int], name: str) -> tuple[str, ...]:
    """Check that a camera belongs to an image of `size` (width, height).

    Raises InputError, naming the argument `name`, if the camera's size differs, or if its principal
    point lies outside the image. Returns a warning if the principal point lies so far from the
    middle that K may belong to an image of another size.
    """
    width, height = size
    if camera.size is not None and tuple(camera.size) != (width, height):
        raise InputError(
            f"{name} is for an image of {camera.size[0]} x {camera.size[1]} pixels, "
            f"the image has {width} x {height}"
        )
    x, y = float(camera.K[0, 2]), float(camera.K[1, 2])
    where = f"{name} has its principal point at ({x:g}, {y:g})"
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        raise InputError(
            f"{where}, outside the image of {width} x {height}: it is for another image size"
        )
    offset = max(abs((x + 0.5) / width - 0.5), abs((y + 0.5) / height - 0.5))
    if offset > _USUAL_OFFSET:
        return (
            f"{where}, far from the middle of the image of {width} x {height}: "
            f"is it for another image size?",
        )
    return ()


def camera_for(value: Camera | Any, size: tuple[int, int], name: str) -> Camera:
    """The camera of an image of `size`, by `as_camera`; its warnings include those of `check_size`.

    Raises InputError, naming the argument `name`, if K is unusable or does not fit the image.
    """
    camera = as_camera(value, name)
    return replace(camera, warnings=camera.warnings + check_size(camera, size, name))


def guess_camera(path: str | Path) -> Camera:
    """A camera guessed from an image file, with a warning that poses will be inaccurate.

    The focal length is that of the file's EXIF data, or else 1.2 times the longer side; the
    principal point is the middle. Raises ImageError if the image cannot be read.
    """
    K, size, from_exif = colmap_camera.guess(Path(path))
    source = "its EXIF data" if from_exif else "nothing but its size (1.2 times the longer side)"
    warning = (
        f"{path}: the focal length of {K[0, 0]:.0f} pixels is a guess from {source}; "
        f"expect the pose to be much less accurate than with a calibration"
    )
    return Camera(K, size, warnings=(warning,), guessed_focal=True)


def _checked_matrix(value: Any, name: str) -> np.ndarray:
    """A read-only copy (3, 3) float64 of an intrinsic matrix."""
    K = np.array(as_numpy(value, name), dtype=np.float64)
    if K.shape != (3, 3):
        raise InputError(f"{name} must have shape (3, 3), not {K.shape}")
    if not np.isfinite(K).all():
        raise InputError(f"{name} has values that are not finite")
    if np.abs(K[2] - (0, 0, 1)).max() > 1e-9:
        raise InputError(f"{name} must have the last row 0 0 1, not {_listed(K[2])}")
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise InputError(f"{name} must have positive focal lengths, not {_listed(np.diag(K)[:2])}")
    if abs(K[1, 0]) > 1e-9 * K[1, 1]:
        raise InputError(f"{name} must be upper triangular, but its second row is {_listed(K[1])}")
    if np.linalg.matrix_rank(K) < 3:
        raise InputError(f"{name} is singular")
    K[1, 0], K[2] = 0, (0, 0, 1)
    K.setflags(write=False)
    return K


def _listed(numbers: np.ndarray) -> str:
    return " ".join(f"{number:g}" for number in numbers)


def _read_matrix(path: Path, name: str) -> np.ndarray:
    """The numbers of a file, (3, 3) if they are nine; commas and line breaks are as blanks."""
    try:
        with read_as("a 3x3 matrix", path):
            if path.suffix.lower() == ".npy":
                matrix = read_array(path)
            else:
                text = read_text(path, "a 3x3 matrix", _MAX_FILE_BYTES).replace(",", " ")
                matrix = np.loadtxt(io.StringIO(text), ndmin=2)
            if not matrix.size:
                raise InputError(f"{path} is empty")
            return matrix.reshape(3, 3) if matrix.size == 9 else matrix
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except OSError as error:
        raise InputError(f"{name}: {path}: {error.strerror or error}") from error


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
