"""Frames with depth and pose, and the posed RGB-D folders they are read from.

A folder holds `images/`, `depth/`, `K.txt` (3x3, pixels of the images) and `poses.txt`, line i the
4x4 world-from-camera matrix, row by row, of the i-th file in sorted order. Depth is 16-bit PNG of
the images' size, along the optical axis, 0 if unknown; a step is a millimetre if the poses are in
metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.errors import ImageError, InputError
from dgc_pose.files.inputs import read_text
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.images.image import image_size, read_pixels

_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_DEPTH_STEP = 1e-3  # metres


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A view whose depth and pose are known. Pixels have (0, 0) at the top-left one's centre."""

    image: Path
    depth: Path  # z along the optical axis in millimetres, of the image's size; 0: unknown
    K: np.ndarray  # (3, 3) float64, pixels of the image as stored
    cam_from_world: np.ndarray  # (4, 4) float64

    def read_depth(self) -> np.ndarray:
        """(h, w) float32, metres, 0 if unknown. Raises ImageError with the path."""
        stored = read_pixels(self.depth)
        if stored.ndim != 2:
            raise ImageError(f"{self.depth} is not a depth image of one channel")
        return stored.astype(np.float32) * np.float32(_DEPTH_STEP)


def read_rgbd(root: str | Path) -> list[PosedFrame]:
    """The frames of a posed RGB-D folder, in order.

    Raises InputError, with the path, if the folder has another layout, the numbers of its files
    differ or a matrix is malformed; ImageError if a file is not an image.
    """
    root = Path(root)
    images = _files(root / "images", _IMAGE_SUFFIXES)
    depths = _files(root / "depth", (".png",))
    K = _read_matrix(root / "K.txt", (3, 3))
    _check_intrinsics(K, root / "K.txt")
    poses = _read_matrix(root / "poses.txt", (-1, 16)).reshape(-1, 4, 4)
    if not len(images) == len(depths) == len(poses):
        counts = f"{len(images)} images, {len(depths)} depths and {len(poses)} poses"
        raise InputError(f"{root}: {counts}; there must be as many of each")
    frames = []
    for line, (image, depth, pose) in enumerate(zip(images, depths, poses, strict=True), start=1):
        _check_rigid(pose, f"{root / 'poses.txt'}:{line}")
        if image_size(image) != image_size(depth):
            raise InputError(f"{depth} is not of the size of {image.name}")
        frames.append(PosedFrame(image, depth, K, np.linalg.inv(pose)))
    return frames


def _read_matrix(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """A text file's numbers in that shape, float64. Raises InputError with the path."""
    try:
        text = read_text(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    try:
        matrix = np.array(text.split(), dtype=np.float64).reshape(shape)
    except ValueError:
        what = f"rows of {shape[1]}" if shape[0] < 0 else f"{shape[0]}x{shape[1]}"
        raise InputError(f"{path}: expected {what} numbers") from None
    if not np.isfinite(matrix).all():
        raise InputError(f"{path}: the numbers must be finite")
    return matrix


def _check_intrinsics(K: np.ndarray, where: str | Path) -> None:
    """Raise InputError if K (3, 3) is not an intrinsic matrix without skew."""
    plain = np.array([[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1]])
    if min(K[0, 0], K[1, 1]) <= 0 or not np.allclose(K, plain, atol=1e-6 * abs(K[0, 0])):
        raise InputError(f"{where}: K must be fx 0 cx, 0 fy cy, 0 0 1 with fx, fy > 0")


def _check_rigid(pose: np.ndarray, where: str | Path) -> None:
    """Raise InputError if a pose (4, 4) is not a rotation and a translation."""
    rigid = is_rotation(pose[:3, :3])
    if not rigid or not np.allclose(pose[3], (0, 0, 0, 1), atol=1e-6):
        raise InputError(f"{where}: a pose must be a rotation and a translation, [R t; 0 0 0 1]")


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    if not files:
        raise InputError(f"{folder}: holds no {' or '.join(suffixes)}")
    return files
