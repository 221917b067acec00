"""Depth and cameras in the layouts of MVSNet and those who followed it.

- DTU as MVSNet prepared it for training: `Cameras/train/00000000_cam.txt` (K in pixels of the depth
  maps), `Depths/scan2_train/depth_map_0000.pfm`, `Rectified/scan2_train/rect_001_3_r5000.png`.
- A folder a scene: `cams/00000000_cam.txt` (K in pixels of the images), images of the same number
  in `images/` or `blended_images/`, depth in `depths/` or `rendered_depth_maps/` (BlendedMVS).

Cam files are as in `dgc_pose/cam_file.py`. K moves between the sizes of a view as in MVSNet's own
tools, x' = s x.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from dgc_pose.cam_file import parse_cam
from dgc_pose.errors import InputError
from dgc_pose.training.posed_depth import (
    PosedFrame,
    check_intrinsics,
    check_rigid,
    stored_size,
)

_CAM = re.compile(r"(\d{8})_cam\.txt")
_IMAGE_FOLDERS = ("images", "blended_images")
_DEPTH_FOLDERS = ("depths", "rendered_depth_maps")
_IMAGE_SUFFIXES = (".jpg", ".png")


def read_mvsnet_dtu(root: str | Path, scan: int, light: int = 3) -> list[PosedFrame]:
    """The views of a scan of MVSNet's DTU training set that have a depth map, in order.

    light: 0 to 6; 3 is the usual one. Raises InputError or ImageError, with the path.
    """
    root = Path(root)
    frames = []
    for number, cam in _cams(root / "Cameras" / "train"):
        name = f"scan{scan}_train"
        image = root / "Rectified" / name / f"rect_{number + 1:03d}_{light}_r5000.png"
        depth = root / "Depths" / name / f"depth_map_{number:04d}.pfm"
        if not depth.is_file():
            continue
        K, pose = read_cam(cam)
        ratio = stored_size(image) / stored_size(depth)
        frames.append(PosedFrame(image, depth, 1.0, _scaled(K, ratio), K, pose))
    if not frames:
        raise InputError(f"{root / 'Depths' / f'scan{scan}_train'}: holds no depth_map_NNNN.pfm")
    return frames


def read_mvsnet_folder(root: str | Path) -> list[PosedFrame]:
    """The views of a folder a scene that have a depth map, in order.

    Raises InputError or ImageError, with the path.
    """
    root = Path(root)
    images = _first_folder(root, _IMAGE_FOLDERS)
    depths = _first_folder(root, _DEPTH_FOLDERS)
    frames = []
    for number, cam in _cams(root / "cams"):
        depth = depths / f"{number:08d}.pfm"
        if not depth.is_file():
            continue
        named = [images / f"{number:08d}{suffix}" for suffix in _IMAGE_SUFFIXES]
        image = next((path for path in named if path.is_file()), named[0])
        K, pose = read_cam(cam)
        ratio = stored_size(depth) / stored_size(image)
        frames.append(PosedFrame(image, depth, 1.0, K, _scaled(K, ratio), pose))
    if not frames:
        raise InputError(f"{depths}: holds no NNNNNNNN.pfm")
    return frames


def read_cam(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """K (3, 3) and cam_from_world (4, 4), float64, of a cam file.

    Raises InputError, with the path, where it is none.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        text = ""
    pose, K = parse_cam(text, path)
    if not (np.isfinite(pose).all() and np.isfinite(K).all()):
        raise InputError(f"{path}: the numbers must be finite")
    check_rigid(pose, path)
    check_intrinsics(K, path)
    return K, pose


def _cams(folder: Path) -> list[tuple[int, Path]]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    named = ((_CAM.fullmatch(path.name), path) for path in sorted(folder.iterdir()))
    found = [(int(match[1]), path) for match, path in named if match]
    if not found:
        raise InputError(f"{folder}: holds no NNNNNNNN_cam.txt")
    return found


def _first_folder(root: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        if (root / name).is_dir():
            return root / name
    raise InputError(f"{root}: has no folder {' or '.join(names)}")


def _scaled(K: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    return np.diag([*ratio, 1.0]) @ K
