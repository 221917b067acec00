"""A model to place photographs in: images with cameras and poses, and points if there are any."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.by_image import Calibration, orientation_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.recognise import read_file
from dgc_pose.colmap.database import HALF_PIXEL
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.geometry.pixels import exif_turn, turn_points
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.images.image import image_header, size_in_file
from dgc_pose.system.colmap_library import pycolmap


@dataclass(frozen=True, eq=False)
class PosedModel:
    """Upright images of one folder with their cameras and poses, all in one frame and unit.

    Attributes:
        root: Folder of the image names.
        cameras: By image name, with the size of the image.
        poses: cam_from_world (3, 4), [R | t] with x = R X + t, by image name.
        points: By image name the points (N, 3), world, that the image shows, and where, (N, 2),
            pixels; empty without points.
        warnings: Sentences about what is missing, for people.
        files: COLMAP's folder of the model; None if it is of another kind.
    """

    root: Path
    cameras: Mapping[str, Camera]
    poses: Mapping[str, np.ndarray]
    points: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    files: Path | None = None

    def centre(self, name: str) -> np.ndarray:
        """Position (3,) of a camera, world."""
        pose = self.poses[name]
        centre: np.ndarray = -pose[:, :3].T @ pose[:, 3]
        return centre

    @property
    def extent(self) -> float:
        """The largest distance of two cameras, in the model's unit."""
        centres = np.stack([self.centre(name) for name in self.poses])
        return float(np.linalg.norm(centres[:, None] - centres, axis=-1).max())


def load_model(source: str | os.PathLike[str], images: str | os.PathLike[str]) -> PosedModel:
    """The model of a file or folder, with its images in the folder `images`.

    source: the folder of a COLMAP model or of `dgc-pose reconstruct`; NeRF's transforms.json; or a
    .csv with name, qw, qx, qy, qz, tx, ty, tz of cam_from_world and fx, fy, cx, cy. Images that are
    missing are left out with a warning.

    Raises InputError if there are no poses, several models, a pose that is none, no two images, or
    a camera that does not fit its image; ImageError for a broken image; OSError.
    """
    path, root = model_path(Path(source)), Path(images)
    if not root.is_dir():
        raise InputError(ArgumentName("images"), f"{root}: no such folder")
    file = read_file(path)
    if not file.poses:
        raise InputError(ArgumentName("model"), f"{path} has no poses of images")
    calibration = Calibration(str(path), parts=file.parts, common=file.common)
    names = {name: _image_name(root, name, path.parent) for name in file.poses}
    if len(names) < 2:
        raise InputError(ArgumentName("model"), f"{path} has the pose of one image, two are needed")
    missing = sorted(name for name, there in names.items() if there is None)
    count = f"{len(missing)} of {len(names)} images (first: {', '.join(missing[:3])})"
    if len(names) - len(missing) < 2:
        raise InputError(ArgumentName("images"), f"{root} lacks {count} of {path}")
    cameras, poses, points, observed = {}, {}, {}, _observations(path)
    for stated, name in names.items():
        pose = file.poses[stated]
        if not (is_rotation(pose[:, :3]) and np.isfinite(pose).all()):
            raise InputError(ArgumentName("model"), f"{path}: {stated} has a pose that is none")
        if name is not None:
            header = image_header(root / name)
            stated_camera = {name: file.by_name[stated]} if stated in file.by_name else {}
            of_image = replace(calibration, by_name=stated_camera)
            camera = of_image.camera(root, name, header)
            cameras[name] = replace(camera.as_exact(), size=header.size)  # the poses are of these
            # A model of the pixels as stored is turned with them.
            K = of_image.stated(root, name)
            turn = exif_turn(1 if K is None else orientation_of(K, header))
            if np.linalg.det(turn) < 0:
                raise InputError(f"{root / name}: its pixels as stored are a mirror image, by EXIF")
            poses[name] = np.concatenate([turn @ pose[:2], pose[2:]])
            if stated in observed:
                xyz, xy = observed[stated]
                points[name] = xyz, turn_points(xy, turn, size_in_file(header))
    warnings = (f"{root} lacks {count} of {path}",) if missing else ()
    return PosedModel(root, cameras, poses, points, warnings, path if path.is_dir() else None)


def _observations(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The points (N, 3) of a COLMAP model that each image shows, and their pixels (N, 2)."""
    if not any((path / f"points3D.{ending}").is_file() for ending in ("bin", "txt")):
        return {}
    with read_as("a COLMAP model", path):
        model = pycolmap.Reconstruction(path)
    observed = {}
    for image in model.images.values():
        seen = [point for point in image.points2D if point.has_point3D()]
        if seen:
            xyz = np.stack([model.points3D[point.point3D_id].xyz for point in seen])
            observed[image.name] = xyz, np.stack([point.xy for point in seen]) - HALF_PIXEL
    return observed


def model_path(path: Path) -> Path:
    """The file or the folder of COLMAP's files that a source stands for."""
    if not path.is_dir():
        if not path.exists():
            raise InputError(ArgumentName("model"), f"{path}: no such file or folder")
        return path
    for places in ("", "*/", "sparse/*/"):  # the last of results
        files = [f for ending in ("bin", "txt") for f in path.glob(f"{places}cameras.{ending}")]
        models = sorted({file.parent for file in files})
        if len(models) > 1:
            listed = ", ".join(folder.name for folder in models)
            raise InputError(ArgumentName("model"), f"{models[0].parent} has the models {listed}")
        if models:
            return models[0]
    raise InputError(ArgumentName("model"), f"{path} holds no model of COLMAP")


def _image_name(root: Path, name: str, folder: Path) -> str | None:
    """The name, relative to the root, of the image that a model in a folder has under a name: that
    path, from either, or its last part; NeRF's names may lack their ending. None if there is none.
    """
    stated = os.path.normpath(os.path.join(os.path.realpath(folder), name))
    relative = os.path.relpath(stated, os.path.realpath(root))
    for candidate in dict.fromkeys((os.path.normpath(name), relative, Path(name).name)):
        if candidate.startswith(os.pardir + os.sep):  # of another folder
            continue
        if os.path.isfile(root / candidate):
            return candidate
        if not Path(candidate).suffix and (root / candidate).parent.is_dir():
            same = sorted((root / candidate).parent.glob(f"{Path(candidate).name}.*"))
            if len(same) == 1:
                return same[0].relative_to(root).as_posix()
    return None
