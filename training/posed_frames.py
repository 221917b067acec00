"""Photographs with poses, and with a sensor's depth if any, from folders (docs/training.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ImageError, InputError
from dgc_pose.geometry.pixels import same_shape
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.images.decoding import image_size, read_pixels
from dgc_pose.images.folder import search_images
from dgc_pose.model import load_model
from dgc_pose.system.files import read_as, read_text

# Quantiles of the points' depths, for a frame's reach
_NEAREST = 0.02
_FARTHEST = 0.98
_MARGIN = 1.25  # factor by which the reach extends beyond these quantiles


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A view with a known pose. Pixel (0, 0) is the centre of the top-left pixel.

    Raises InputError, with the image, if the pose is not rigid or K has a skew.
    """

    image: Path
    camera: Camera  # of the upright image
    cam_from_world: np.ndarray  # (4, 4) float64
    depth: Path | None = None  # image of z along the optical axis; 0: unknown
    step: float = 1e-3  # unit of the stored depth, in units of length
    reach: tuple[float, float] | None = None  # nearest and farthest depth; None: by a sensor

    def __post_init__(self) -> None:
        R = self.cam_from_world[:3, :3]
        last = self.cam_from_world[3]
        is_pose = is_rotation(R) and np.isfinite(self.cam_from_world).all()
        if not (is_pose and np.allclose(last, (0, 0, 0, 1), atol=1e-6)):
            raise InputError(f"{self.image}: its pose is not a rotation and translation")
        if abs(self.camera.K[0, 1]) > 1e-6 * self.camera.K[0, 0]:
            raise InputError(f"{self.image}: its K must be fx 0 cx, 0 fy cy, 0 0 1, without skew")

    def read_depth(self) -> np.ndarray:
        """Read the depth, resized to the image: (h, w) float32, units of length, 0 if unknown.

        Raises ImageError, with the path, if it is unreadable; InputError if its shape differs.
        """
        assert self.depth is not None
        stored = read_pixels(self.depth)
        size = image_size(self.image)
        if stored.ndim != 2:
            raise ImageError(f"{self.depth} is not a depth image of one channel")
        if not same_shape(stored.shape[::-1], size):
            sizes = f"{stored.shape[1]} x {stored.shape[0]}, its image {size[0]} x {size[1]}"
            raise InputError(f"{self.depth} has {sizes} pixels: the aspect ratios differ")
        stored = cv2.resize(stored, size, interpolation=cv2.INTER_NEAREST_EXACT)
        return stored.astype(np.float32) * np.float32(self.step)


def read_scenes(root: str | Path) -> dict[str, list[PosedFrame]]:
    """Read the frames of a scene's folder, or of all scenes in a folder, by folder name.

    Raises InputError, with the path, without scenes or if a file is malformed; ImageError; OSError.
    """
    root = Path(root).resolve()  # gives the working folder its name
    folders = [root] if (root / "images").is_dir() else sorted(root.iterdir())
    scenes = {f.name: read_scene(f) for f in folders if (f / "images").is_dir()}
    if not scenes:
        raise InputError(f"{root}: has no scenes (folders with a folder images)")
    return scenes


def read_scene(root: Path) -> list[PosedFrame]:
    """Read the frames of a scene's folder, two or more, in order. Raises as `read_scenes` does."""
    if (root / "poses.txt").exists():
        frames = read_rgbd(root)
    elif (root / "cameras.txt").exists() and not (root / "images.txt").exists():
        frames = _read_listed(root)
    else:
        frames = _read_model(root)
    if len(frames) < 2:
        raise InputError(f"{root}: {len(frames)} frames of known pose and depth; two are needed")
    return frames


def _read_model(root: Path) -> list[PosedFrame]:
    """The frames of a COLMAP model that see points; the points' depths give their reach."""
    model = load_model(root, root / "images")
    frames = []
    for name in sorted(model.seen):
        pose = np.vstack([model.poses[name], (0, 0, 0, 1)])
        depths = model.points[model.seen[name][0]] @ pose[2, :3] + pose[2, 3]
        if (depths > 0).any():
            nearest, farthest = np.quantile(depths[depths > 0], (_NEAREST, _FARTHEST))
            reach = nearest / _MARGIN, farthest * _MARGIN
            image = root / "images" / name
            frames.append(PosedFrame(image, model.cameras[name], pose, reach=reach))
    return frames


def read_rgbd(root: str | Path) -> list[PosedFrame]:
    """Read the frames of a posed RGB-D folder, in order. Raises InputError, with the path, if the
    numbers of files or poses differ or a matrix is malformed; OSError."""
    root = Path(root)
    path = root / "poses.txt"
    folders = root / "images", root / "depth"
    images, depths = ([f / name for name in search_images(f).names] for f in folders)
    camera = parse_camera(str(root / "K.txt"))
    with read_as("rows of 16 numbers", path):
        poses = np.linalg.inv(np.array(read_text(path).split(), float).reshape(-1, 4, 4))
    if not 0 < len(images) == len(depths) == len(poses):
        counts = f"{len(images)} images, {len(depths)} depths and {len(poses)} poses"
        raise InputError(f"{root}: {counts}; the numbers must be equal and at least one")
    cameras = [camera] * len(images)
    return [*map(PosedFrame, images, cameras, poses, depths)]


def _read_listed(root: Path) -> list[PosedFrame]:
    path = root / "cameras.txt"
    scale = root / "depth_scale.txt"
    step = 1e-3
    if scale.exists():
        with read_as("a number of steps", scale):
            step = 1 / float(read_text(scale))
    frames = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        with read_as("a name and 18 numbers", f"{path}:{number}"):
            name, *words = line.split()
            K, Rt, (nearest, farthest) = np.split(np.array(words, float), (4, 16))
            pose = np.vstack([Rt.reshape(3, 4), (0, 0, 0, 1)])
        if not (K[:2].min() > 0 and 0 < nearest < farthest < np.inf):
            wanted = "fx, fy and the depths must be positive, the nearest depth below the farthest"
            raise InputError(f"{path}:{number}: {wanted}")
        image = root / "images" / name
        reach = (nearest, farthest)
        depth = root / "depth" / f"{image.stem}.png" if scale.exists() else None
        frames.append(PosedFrame(image, Camera(K), pose, depth, step, reach))
    return frames
