"""Frames with depth and pose, and the posed RGB-D folders they are read from.

A folder holds `images/`, `depth/`, `K.txt` (3x3, pixels of the images) and `poses.txt`, line i the
4x4 world-from-camera matrix, row by row, of the i-th file in sorted order. Depth is 16-bit PNG of
the images' size, along the optical axis, 0 if unknown; a step is a millimetre if the poses are in
metres.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.errors import ImageError, InputError
from dgc_pose.files.inputs import read_text
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.images.image import image_size, read_pixels


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
        return stored.astype(np.float32) * np.float32(1e-3)


def read_rgbd(root: str | Path) -> list[PosedFrame]:
    """The frames of a posed RGB-D folder, in order.

    Raises InputError, with the path, if the folder has another layout, the numbers of its files
    differ or a matrix is malformed; ImageError if a file is not an image; OSError.
    """
    root = Path(root)
    images = _files(root / "images", (".jpg", ".jpeg", ".png"))
    depths = _files(root / "depth", (".png",))
    K = parse_camera(str(root / "K.txt")).K
    if abs(K[0, 1]) > 1e-6 * K[0, 0]:
        raise InputError(f"{root / 'K.txt'}: K must be fx 0 cx, 0 fy cy, 0 0 1, without skew")
    poses = _read_poses(root / "poses.txt")
    if not len(images) == len(depths) == len(poses):
        counts = f"{len(images)} images, {len(depths)} depths and {len(poses)} poses"
        raise InputError(f"{root}: {counts}; there must be as many of each")
    frames = []
    for line, (image, depth, pose) in enumerate(zip(images, depths, poses, strict=True), start=1):
        if not is_rotation(pose[:3, :3]) or not np.allclose(pose[3], (0, 0, 0, 1), atol=1e-6):
            where = f"{root / 'poses.txt'}:{line}"
            raise InputError(
                f"{where}: a pose must be a rotation and a translation, [R t; 0 0 0 1]"
            )
        if image_size(image) != image_size(depth):
            raise InputError(f"{depth} is not of the size of {image.name}")
        frames.append(PosedFrame(image, depth, K, np.linalg.inv(pose)))
    return frames


def _read_poses(path: Path) -> np.ndarray:
    """World-from-camera matrices (N, 4, 4) float64. Raises InputError with the path; OSError."""
    try:
        poses = np.array(read_text(path).split(), dtype=np.float64).reshape(-1, 4, 4)
    except ValueError:
        raise InputError(f"{path}: expected rows of 16 numbers") from None
    if not np.isfinite(poses).all():
        raise InputError(f"{path}: the numbers must be finite")
    return poses


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    if not files:
        raise InputError(f"{folder}: holds no {' or '.join(suffixes)}")
    return files
