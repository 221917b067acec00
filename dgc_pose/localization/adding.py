"""A COLMAP model with photographs that were located in it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.database import colmap_camera
from dgc_pose.colmap.reconstruction import require_model_folder
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.files.outputs import replaced_folder
from dgc_pose.images.image import image_size
from dgc_pose.localization.location import Location
from dgc_pose.localization.model import PosedModel
from dgc_pose.system.colmap_library import pycolmap


def write_model_with(out: Path, model: PosedModel, locations: Mapping[str, Location]) -> None:
    """Write the model with those photographs that are located, by their paths, as COLMAP's binary
    files: each with a camera of its own, and without points.

    A model of COLMAP keeps all that it has; of another the cameras and poses are written. Raises
    InputError if the folder holds other files, COLMAP cannot hold a camera, or a photograph has the
    name of an image of the model.
    """
    require_model_folder(out)
    if model.files is None:
        reconstruction = pycolmap.Reconstruction()
        for name, pose in model.poses.items():
            _add(reconstruction, name, model.cameras[name], pose)
    else:
        with read_as("a COLMAP model", model.files):
            reconstruction = pycolmap.Reconstruction(model.files)
    names = {image.name for image in reconstruction.images.values()}
    for path, location in locations.items():
        name, camera = Path(path).name, location.camera
        if location.cam_from_world is None or camera is None:
            continue
        if name in names:
            raise InputError(f"{path}: the model has an image {name}")
        names.add(name)
        sized = camera if camera.size else replace(camera, size=image_size(path))
        _add(reconstruction, name, sized, location.cam_from_world)
    with replaced_folder(out) as folder:
        reconstruction.write_binary(folder)


def _add(
    reconstruction: pycolmap.Reconstruction, name: str, camera: Camera, pose: np.ndarray
) -> None:
    """Add an image with a camera of its own."""
    added = colmap_camera(camera, name)
    added.camera_id = max(reconstruction.cameras, default=0) + 1
    reconstruction.add_camera_with_trivial_rig(added)
    image = pycolmap.Image(name=name, camera_id=added.camera_id)
    image.image_id = max(reconstruction.images, default=0) + 1
    cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
    reconstruction.add_image_with_trivial_frame(image, cam_from_world)
