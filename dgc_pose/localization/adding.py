"""A COLMAP model with photographs that were located in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.database import colmap_camera
from dgc_pose.colmap.reconstruction import require_model_folder
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.files.outputs import replaced_folder
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.image import image_header
from dgc_pose.localization.location import Location
from dgc_pose.localization.model import PosedModel
from dgc_pose.system.colmap_library import pycolmap


def extensible(out: Path, model: PosedModel, paths: Sequence[str]) -> pycolmap.Reconstruction:
    """The model, to add photographs to: of COLMAP with all that it has, of another kind with its
    cameras and poses.

    Raises InputError if the folder holds other files, a photograph has the name of another or of an
    image of the model, or its pixels as stored are a mirror image.
    """
    require_model_folder(out)
    if model.files is None:
        reconstruction = pycolmap.Reconstruction()
        for name, pose in model.poses.items():
            _add(reconstruction, name, model.root / name, model.cameras[name], pose)
    else:
        with read_as("a COLMAP model", model.files):
            reconstruction = pycolmap.Reconstruction(model.files)
    names = {image.name for image in reconstruction.images.values()}
    for path in paths:
        name, orientation = Path(path).name, image_header(Path(path)).exif.orientation
        if name in names:
            raise InputError(ArgumentName("add"), f"has an image {name} already, not {path} too")
        if np.linalg.det(exif_turn(orientation)) < 0:
            raise InputError(
                f"{path}: by EXIF orientation {orientation} its pixels are a mirror image"
            )
        names.add(name)
    return reconstruction


def write_model_with(
    out: Path, model: pycolmap.Reconstruction, locations: Mapping[str, Location]
) -> None:
    """Write an `extensible` model with those photographs that are located, by their paths, as
    COLMAP's binary files: each with a camera of its own, of its pixels as stored, and without
    points. Raises InputError if COLMAP cannot hold a camera."""
    for path, location in locations.items():
        pose, camera = location.cam_from_world, location.camera
        if pose is not None and camera is not None:
            _add(model, Path(path).name, Path(path), camera, pose)
    with replaced_folder(out) as folder:
        model.write_binary(folder)


def _add(
    reconstruction: pycolmap.Reconstruction,
    name: str,
    path: Path,
    camera: Camera,
    pose: np.ndarray,
) -> None:
    """Add an image with a camera of its own, of its pixels as stored. camera, pose: of the upright
    image."""
    header = image_header(path)
    turn = exif_turn(header.exif.orientation).T
    pose = np.concatenate([turn @ pose[:2], pose[2:]])
    added = colmap_camera(camera.turned(turn, header.size), name)
    added.camera_id = max(reconstruction.cameras, default=0) + 1
    reconstruction.add_camera_with_trivial_rig(added)
    image = pycolmap.Image(name=name, camera_id=added.camera_id)
    image.image_id = max(reconstruction.images, default=0) + 1
    cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
    reconstruction.add_image_with_trivial_frame(image, cam_from_world)
