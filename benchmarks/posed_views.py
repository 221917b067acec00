"""Photographs of a scene with true camera poses: what reconstructions are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.calibration import read_projection
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import replaced, require_no_input, writing
from dgc_pose.images.image import image_size, load_image, resize_by


@dataclass(frozen=True, eq=False)
class PosedViews:
    """Images of one folder, with true poses in one frame and unit."""

    root: Path
    cameras: Mapping[str, Camera]  # by name, with the image's size
    poses: Mapping[str, np.ndarray]  # cam_from_world (3, 4) by name

    def centre(self, name: str) -> np.ndarray:
        """The true position (3,) of a camera."""
        pose = self.poses[name]
        return -pose[:, :3].T @ pose[:, 3]

    def resized(self, scale: float, folder: Path) -> PosedViews:
        """Copies of the images by area means, as PNG in `folder`, with their cameras.

        Raises InputError if a copy would replace an image; OSError if it cannot be written.
        """
        copies = {name: str(Path(name).with_suffix(".png")) for name in self.cameras}
        images = [self.root / name for name in copies]
        require_no_input([folder / copy for copy in copies.values()], images)
        cameras = {}
        for name, copy in copies.items():
            small = resize_by(load_image(self.root / name).pixels, scale)
            (folder / copy).parent.mkdir(parents=True, exist_ok=True)
            with replaced(folder / copy) as stage, writing(stage):
                stage.write_bytes(cv2.imencode(".png", small[:, :, ::-1])[1].tobytes())
            cameras[copy] = self.cameras[name].resized((small.shape[1], small.shape[0]))
        return PosedViews(folder, cameras, {copies[name]: self.poses[name] for name in copies})


def views_of_list(path: Path, folder: Path) -> PosedViews:
    """The views of a SuperGlue list whose translations have one unit, chained from pair to pair.

    folder: of the images; names are those of the list relative to it. Raises InputError if the
    pairs do not connect all images.
    """
    cameras: dict[str, Camera] = {}
    steps: dict[str, list[tuple[str, np.ndarray]]] = {}  # by image, others with their poses in it
    for pair in read_pairs(path):
        name1, name2 = _relative(pair.path1, folder), _relative(pair.path2, folder)
        step = np.vstack([np.column_stack([pair.R, pair.t]), [0, 0, 0, 1]])
        steps.setdefault(name1, []).append((name2, step))
        steps.setdefault(name2, []).append((name1, np.linalg.inv(step)))
        cameras.setdefault(name1, pair.camera1)
        cameras.setdefault(name2, pair.camera2)
    reached = [min(steps)]
    poses = {reached[0]: np.eye(4)}
    for name in reached:  # grows on the way
        for other, step in steps[name]:
            if other not in poses:
                poses[other] = step @ poses[name]
                reached.append(other)
    if len(poses) < len(cameras):
        raise InputError(f"{path}: its pairs do not connect all images")
    sized = {
        name: replace(camera, size=image_size(folder / name))
        for name, camera in sorted(cameras.items())
    }
    return PosedViews(folder, sized, {name: pose[:3] for name, pose in poses.items()})


def views_of_dtu(calibration: Path, folder: Path) -> PosedViews:
    """The images `rect_NNN_...` of a scene of DTU with the matrices `pos_NNN.txt`; millimetres.

    Raises InputError if there is no such image, or a matrix is missing or malformed.
    """
    cameras, poses = {}, {}
    for path in sorted(folder.glob("rect_[0-9][0-9][0-9]*")):
        position = path.name.split("_")[1]
        view = read_projection(calibration / f"pos_{position}.txt")
        cameras[path.name] = Camera(view.K, image_size(path))
        poses[path.name] = np.column_stack([view.R, view.t])
    if len(poses) < 2:
        raise InputError(f"{folder}: no images rect_NNN of a DTU scene")
    return PosedViews(folder, cameras, poses)


def _relative(path: Path, folder: Path) -> str:
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        raise InputError(f"{path}: not an image of the folder {folder}") from None
